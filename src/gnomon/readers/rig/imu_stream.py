"""Samples of one IMU, read from its table or tables, in SI units and in the order of time, for use beside cameras."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import RecordingError
from ...formats.kalibr.imu import ImuInput
from ...recording import ImuSamples, Source, TriadSamples
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, Units
from ..recordings import read_recognising
from ..samples.recognise import HELP, IN_MOTION, TRIAL
from ..samples.stamps import stray_timestamp
from ..samples.table import RATE_HELP

_RATE_TOLERANCE = 0.05
_HEADER = "Name the columns in the first line, such as ts_ns,wx,wy,wz,ax,ay,az (ts_ns in nanoseconds)."


def read_imu(
    name: str,
    files: tuple[Path, ...],
    known: ImuInput | None,
    *,
    units: Units,
    sources: list[Source],
    notes: list[str],
) -> ImuSamples:
    """Read the samples of one IMU that moved all the time.

    Parameters
    ----------
    name : "imu0", "imu1", ...
    files : its table, or those of accelerometer and gyroscope
    known : what is stated of it, or None
    units : as stated; recognised where they are not
    sources : where the files that were read are appended
    notes : where sentences on what was assumed are appended

    Returns
    -------
    both triads in m/s^2 and rad/s, in the order of time

    Raises
    ------
    RecordingError
        If the samples cannot be read, are raw counts, lack a triad, or their clock was set anew.
    """
    try:
        recording = read_recognising(IN_MOTION, *files, units=units)
    except RecordingError as error:  # there are no options here for tables that say too little
        text = re.sub(TRIAL.format('[^"]*', "[^.]*"), "", _in_place(str(error), files))
        raise RecordingError(
            text.partition(RATE_HELP)[0].replace(HELP, _HEADER) + (_HEADER if RATE_HELP in text else "")
        ) from None
    sources.extend(replace(source, name=_in_place(source.name, files)) for source in recording.sources)
    said = [_in_place(note, files) for note in recording.assumptions]
    notes.extend(note if name == "imu0" else f"{name}: {note}" for note in said)
    samples = recording.imus["imu0"]
    file = _in_place(files[0].name, files)
    if not len(samples.gyroscope):
        raise RecordingError(f"{file}: found no gyroscope; both triads of the IMU are needed.")
    accelerometer = in_order(_si(samples.accelerometer, "accelerometer", file, notes), name, notes)
    gyroscope = in_order(_si(samples.gyroscope, "gyroscope", _in_place(files[-1].name, files), notes), name, notes)
    if known is None:
        return ImuSamples(accelerometer=accelerometer, gyroscope=gyroscope)
    stated, found = known.update_rate_hz, gyroscope.rate_hz
    if stated is not None and abs(found / stated - 1) > _RATE_TOLERANCE:
        notes.append(
            f"{name}: its samples come at {found:.4g} Hz, not at the stated update_rate of {stated:g} Hz; "
            "the noise densities do not depend on it."
        )
    return with_stated(ImuSamples(accelerometer=accelerometer, gyroscope=gyroscope), known)


def with_stated(samples: ImuSamples, known: ImuInput) -> ImuSamples:
    """Return samples with what is stated of their IMU; the topic of a bag stays."""
    return replace(
        samples,
        noise=known.noise,
        topic=samples.topic or known.topic,
        T_imu_body=known.T_imu_body,
        time_shift_s=known.time_shift_s,
    )


def _in_place(text: str, files: tuple[Path, ...]) -> str:
    """Return a text that begins with the name of a file, with the folder before it that tells whose data.csv it is."""
    named = next((file for file in files if text.startswith(file.name)), None)
    return text if named is None or named.stem != "data" else f"{named.parent.name}/{text}"


def _si(samples: TriadSamples, sensor: str, file: str, notes: list[str]) -> TriadSamples:
    """Return samples in m/s^2 or rad/s."""
    table = ACCELEROMETER_UNITS_M_S2 if sensor == "accelerometer" else GYROSCOPE_UNITS_RAD_S
    si = next(iter(table))
    factor = table[samples.unit]
    if factor is None:
        raise RecordingError(
            f"{file}: the {sensor} is in raw counts, but m/s^2 and rad/s are needed here. If it is in another "
            'unit, state it, for example --units "g deg/s". If these are counts, calibrate the IMU alone first '
            "(gnomon imu) and convert the samples with that (gnomon apply)."
        )
    if factor == 1:
        return replace(samples, unit=si)
    notes.append(f"{file}: the {sensor} was converted from {samples.unit} to {si}.")
    return replace(samples, values=samples.values * factor, unit=si)


def in_order(samples: TriadSamples, name: str, notes: list[str]) -> TriadSamples:
    """Return samples in the order of time; of those that share a timestamp the order of the file stays.

    Parameters
    ----------
    samples : one triad
    name : of the IMU, for messages
    notes : where a sentence on samples that were sorted is appended, once for both triads

    Raises
    ------
    RecordingError
        If a timestamp is far from all others, or the clock was set anew.
    """
    far = stray_timestamp(samples.t_ns)
    if far is not None:
        raise RecordingError(
            f"{name}: the timestamp of sample {far}, {samples.t_ns[far]} ns, is more than half a day from the middle "
            f"of the others, {int(np.median(samples.t_ns))} ns. Fix or remove this sample."
        )
    steps = np.diff(samples.t_ns)
    backward = np.flatnonzero(steps < 0)
    if not len(backward):
        return samples
    order = np.argsort(samples.t_ns, kind="stable")
    # Samples that were only out of order make few breaks; two times that ran side by side make one at every sample.
    if np.count_nonzero(np.diff(order) != 1) > 3 * len(backward):
        first = int(backward[0])
        raise RecordingError(
            f"{name}: the timestamps jump back by {-steps[first] * 1e-9:.6g} s after sample {first} and then run "
            "through times that were there before. The clock was set anew: cut the recording there."
        )
    note = f"{name}: the timestamps go back at {len(backward)} of {len(samples)} samples, which were sorted."
    if note not in notes:  # both triads mostly share their timestamps
        notes.append(note)
    return replace(samples, t_ns=samples.t_ns[order], values=samples.values[order])
