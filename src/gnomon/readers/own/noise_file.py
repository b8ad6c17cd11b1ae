"""gnomon's file of the noise of an IMU, schema "gnomon-noise/1"; written by `writers.noise_file`."""

import re
from os import PathLike
from typing import cast

from ...calibration import Verdict
from ...errors import FormatError
from ...sensor_noise import COEFFICIENTS, UNITS, AxisNoise, Coefficient, SensorNoise, TriadNoise
from ..structured import Node, read_text, read_yaml
from .calibration_file import finding_entry, provenance_entry

NOISE_SCHEMA = "gnomon-noise/1"
AXES = ("x", "y", "z")
_VERDICTS = ("pass", "warn", "fail")
_PER_SAMPLE = ("white_noise_per_sample", "random_walk_per_sample")


def is_noise(path: str | PathLike[str]) -> bool:
    """Return whether a file says that it is gnomon's own file of noise."""
    return re.search(r"(?m)^schema\s*:\s*[\"']?gnomon-noise/", read_text(path)) is not None


def load_noise(path: str | PathLike[str]) -> SensorNoise:
    """Read the noise of an IMU from gnomon's noise.yaml.

    Raises
    ------
    FormatError
        If the file cannot be read, or is not as the schema says; the message names the key.
    """
    root = read_yaml(path)
    if not isinstance(root.value, dict) or "schema" not in root.value:
        raise FormatError(
            f"{path}: this is no noise.yaml of gnomon's (there is no key schema). Name the one that gnomon noise wrote."
        )
    if root.child("schema").text() != NOISE_SCHEMA:
        raise root.child("schema").fail(f'found "{root.child("schema").value}", expected {NOISE_SCHEMA}.')
    top = root.mapping(("schema", "verdict", "findings", "provenance"), ("accelerometer", "gyroscope", "t_init"))
    if "accelerometer" not in top and "gyroscope" not in top:
        raise root.fail("neither accelerometer nor gyroscope is in it. One of them is needed.")
    return SensorNoise(
        accelerometer=_triad(top["accelerometer"]) if "accelerometer" in top else None,
        gyroscope=_triad(top["gyroscope"]) if "gyroscope" in top else None,
        t_init_s=top["t_init"].number() if "t_init" in top else float("nan"),
        verdict=cast(Verdict, top["verdict"].text(_VERDICTS)),
        findings=tuple(finding_entry(item) for item in top["findings"].items()),
        provenance=provenance_entry(top["provenance"]),
    )


def _triad(node: Node) -> TriadNoise:
    keys = node.mapping(("update_rate", "samples", "averaging_times", "units", "axes"), _PER_SAMPLE)
    units = keys["units"].mapping(COEFFICIENTS, _PER_SAMPLE)
    for name in COEFFICIENTS:
        units[name].text((UNITS[node.key][name],))
    rate_hz, samples = keys["update_rate"].number(), keys["samples"].integer()
    if rate_hz <= 0:
        raise keys["update_rate"].fail(f"found {rate_hz:g}, expected a rate greater than zero, in Hz.")
    if samples < 1:
        raise keys["samples"].fail(f"found {samples}, expected the number of samples.")
    first, last = keys["averaging_times"].floats(2).tolist()
    axes = keys["axes"].mapping(AXES)
    x, y, z = (_axis(axes[name]) for name in AXES)
    return TriadNoise(rate_hz=rate_hz, samples=samples, tau_s=(first, last), axes=(x, y, z))


def _axis(node: Node) -> AxisNoise:
    keys = node.mapping((*COEFFICIENTS, "fitted_from", "misfit"))
    return AxisNoise(
        **{name: _coefficient(keys[name]) for name in COEFFICIENTS},
        fitted_from_s=keys["fitted_from"].number(),
        misfit=keys["misfit"].number(),
    )


def _coefficient(node: Node) -> Coefficient:
    """Return a value with its sigma, or a bound."""
    keys = node.mapping((), ("value", "sigma", "below"))
    if set(keys) not in ({"value", "sigma"}, {"below"}):
        raise node.fail(
            f"expected value and sigma, or below where none was found; found {', '.join(keys) or 'nothing'}."
        )
    found = {key: child.number() for key, child in keys.items()}
    for key, number in found.items():
        if number <= 0:
            raise keys[key].fail(f"found {number:g}, expected a number greater than zero.")
    if "below" in found:
        return Coefficient(value=0.0, bound=found["below"])
    return Coefficient(value=found["value"], sigma=found["sigma"])
