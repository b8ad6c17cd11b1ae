"""How parameters of a sensor depend on its temperature."""
