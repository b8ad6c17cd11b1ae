"""What each triad of one sensor measured many times, as the sections of its report need it."""

from ...frozen import value_class
from ...results.sensor_diagnostics import ImuDiagnostics, IntervalTable, PoseTable, TriadDiagnostics, TriadRecord

COUNTED = {
    "imu": ("static interval", "static intervals"),
    "poses": ("pose", "poses"),
    "turntable": ("steady part", "steady parts"),
    "magnetometer": ("stretch", "stretches"),
}
"""What one row of a table of vectors is; of the magnetometer, samples close together."""
VECTOR_QUANTITIES = {
    "specific force": ("|f| − g", "gravity", "a {} with this direction up would help most"),
    "angular rate": ("|ω| − rate", "the axis of rotation", "mounting the sensor with this direction upwards would "
                     "help most"),
    "magnetic field": ("|h| − field", "the magnetic field", "turning the sensor until the field points there would "
                       "help most"),
}  # fmt: skip
"""Symbol of the error, what pointed, and where it should point."""
MOST_ROWS = 60
"""Rows of a table beyond this are counted instead of shown."""


@value_class(eq=True, kw_only=False)
class Vectors:
    """A vector of known magnitude that one triad measured many times."""

    name: str
    table: IntervalTable | PoseTable
    quantity: str
    si_unit: str
    record: TriadRecord | None = None


def kind_of(diagnostics: ImuDiagnostics | TriadDiagnostics) -> str:
    """Return what was done: "imu", "poses", "turntable" or "magnetometer"."""
    return "imu" if isinstance(diagnostics, ImuDiagnostics) else diagnostics.kind


def vectors_of(diagnostics: ImuDiagnostics | TriadDiagnostics) -> list[Vectors]:
    """Return what each triad measured."""
    if isinstance(diagnostics, ImuDiagnostics):
        return [Vectors("accelerometer", diagnostics.intervals, "specific force", "m/s^2")]
    return [Vectors(name, r.poses, r.quantity, r.si_unit, r) for name, r in diagnostics.triads.items()]
