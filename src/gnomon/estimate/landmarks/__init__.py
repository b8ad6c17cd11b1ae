"""Where landmarks of a scene are, and how a camera and an IMU moved among them."""
