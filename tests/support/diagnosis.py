"""Whether the causes of faults are named: every fault of the catalogue, checked and calibrated like any recording.

And whether recordings with nothing wrong with them are left alone.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from gnomon.assess.checks.doctor import check
from gnomon.assess.checks.rig_doctor import check_corners
from gnomon.calibrate.camera_imu import calibrate_camera_imu
from gnomon.calibrate.imu import calibrate_imu
from gnomon.errors import GnomonError
from gnomon.findings import Finding
from gnomon.options import CameraImuOptions
from gnomon.results.calibration import Assessment, Verdict
from gnomon.study.runs import HERE, Progress, Workers, carry_out

from .fault_recordings import faulty_recording, sound_recording
from .faults import Fault, FaultKind, FaultyRecording, fault_named
from .healthy import healthy_imu, healthy_rig

_LOUD = ("problem", "warning")


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """What was said of a recording with a fault.

    Attributes
    ----------
    fault, seed : which recording; of a healthy one its kind
    findings : of the calibration, worst first; of the doctor where there was no calibration
    noticed : of the doctor, before the calibration
    error : message where there was no calibration, else ""
    verdict : of the calibration; "fail" where there was none
    added : steps of the model choice that are in the model
    """

    fault: str
    seed: int
    findings: tuple[Finding, ...]
    noticed: tuple[Finding, ...]
    error: str
    verdict: Verdict
    added: tuple[str, ...] = ()

    @property
    def loud(self) -> tuple[Finding, ...]:
        """What the owner is warned of."""
        return tuple(finding for finding in self.findings if finding.severity in _LOUD)

    @property
    def named(self) -> bool:
        """Whether the right cause is named, by the calibration or by what keeps it from being made."""
        fault = fault_named(self.fault)
        taken_up = any(step in self.added for step in fault.added)
        return taken_up or says(fault, self.error) or names_cause(fault, self.findings)

    @property
    def first(self) -> bool:
        """Whether it is the first that its owner reads."""
        fault = fault_named(self.fault)
        if says(fault, self.error):
            return True
        return names_cause(fault, self.loud[:1]) if self.loud else self.named

    @property
    def noticed_before(self) -> bool:
        """Whether the doctor names it before anything is calibrated."""
        return names_cause(fault_named(self.fault), self.noticed)


def names_cause(fault: Fault, findings: Sequence[Finding]) -> bool:
    """Tell whether findings name the cause: loudly, or at all where the calibration mends it."""
    heard = findings if fault.remedied else [finding for finding in findings if finding.severity in _LOUD]
    return any(finding.code in fault.codes and (not fault.says or says(fault, str(finding))) for finding in heard)


def says(fault: Fault, text: str) -> bool:
    """Tell whether a text says of a fault what has to be said."""
    return bool(text and fault.says) and all(re.search(pattern, text) for pattern in fault.says)


def diagnosed(task: tuple[str, int]) -> Diagnosis:
    """Check and calibrate one recording: a fault of the catalogue by name, and a seed."""
    name, seed = task
    return _diagnosed(faulty_recording(fault_named(name), seed), name, seed)


def _diagnosed(case: FaultyRecording, name: str, seed: int) -> Diagnosis:
    noticed = doctors_findings(case)
    findings, error, verdict, added = noticed, "", "fail", tuple[str, ...]()
    try:
        assessment = calibrated(case)
    except GnomonError as failed:
        error = str(failed)
    else:
        findings, verdict, added = assessment.findings, assessment.verdict, assessment.trust.added
    return Diagnosis(
        fault=name, seed=seed, findings=findings, noticed=noticed, error=error, verdict=verdict, added=added
    )


def doctors_findings(case: FaultyRecording) -> tuple[Finding, ...]:
    """Return what `gnomon check` says of a recording."""
    return check(case.recording) if case.target is None else check_corners(case.recording, case.target)


def calibrated(case: FaultyRecording) -> Assessment:
    """Return the assessment of a calibration as its owner would make it."""
    if isinstance(case.options, CameraImuOptions):
        assert case.target is not None
        return calibrate_camera_imu(case.recording, case.target, case.options).calibration.assessment
    return calibrate_imu(case.recording, case.options).calibration.assessment


def healthy(task: tuple[FaultKind, int]) -> Diagnosis:
    """Check and calibrate one recording with nothing wrong with it: its kind, and a seed."""
    kind, seed = task
    return _diagnosed(sound_recording(healthy_imu(seed) if kind == "imu" else healthy_rig(seed), seed), kind, seed)


def study_faults(
    names: Sequence[str], seeds: Sequence[int], *, workers: Workers = HERE, progress: Progress | None = None
) -> list[Diagnosis]:
    """Return a diagnosis for each fault and seed; seeds of one fault follow each other."""
    tasks = [(name, seed) for name in names for seed in seeds]
    return carry_out(diagnosed, tasks, workers=workers, progress=progress, name="recording")


def study_healthy(
    kinds: Sequence[FaultKind], seeds: Sequence[int], *, workers: Workers = HERE, progress: Progress | None = None
) -> list[Diagnosis]:
    """Return a diagnosis for each kind and seed of recordings with nothing wrong with them."""
    tasks: list[tuple[FaultKind, int]] = [(kind, seed) for kind in kinds for seed in seeds]
    return carry_out(healthy, tasks, workers=workers, progress=progress, name="recording")


def table(diagnoses: Sequence[Diagnosis]) -> str:
    """Return a table for people: fault, seed, whether named, named first, and by the doctor; what was said first."""
    rows = [f"{'fault':28} seed  named  first  check  said first"]
    for one in diagnoses:
        said = one.error[:60] or (one.loud[0].code if one.loud else one.verdict)
        marks = "  ".join(f"{'yes' if mark else '-':5}" for mark in (one.named, one.first, one.noticed_before))
        rows.append(f"{one.fault:28} {one.seed:4}  {marks}  {said}")
    return "\n".join(rows)
