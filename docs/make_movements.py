"""Draw the movements that a recording needs as small animations, docs/movements/*.svg.

    python docs/make_movements.py

Each is one SVG that needs no script: SMIL moves the corners of a box, of a camera or of a record player through a
second or two per attitude, three times, and stops. What is drawn is computed here, by the rotations that are meant.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gnomon.geometry.rotations import rotation_from_rotvec

FOLDER = Path(__file__).parent / "movements"
Floats = NDArray[np.float64]
SIZE, SCALE = 240, 62.0
BOX = np.array([[x, y, z] for x in (-1, 1) for y in (-0.66, 0.66) for z in (-0.3, 0.3)], dtype=float)
FACES = {
    "x": (4, 5, 7, 6),
    "-x": (0, 2, 3, 1),
    "y": (2, 6, 7, 3),
    "-y": (0, 1, 5, 4),
    "z": (1, 3, 7, 5),
    "-z": (0, 4, 6, 2),
}
COLORS = {"x": "#0072b2", "y": "#d55e00", "z": "#009e73"}
LOOK = rotation_from_rotvec(np.radians([-62.0, 0, 0])) @ rotation_from_rotvec(np.radians([0, 0, -28.0]))
"""From the table (z up) to right, up and towards the reader."""


def between(rotations: Sequence[Floats], turning: int, resting: int) -> list[Floats]:
    """Return frames that turn from one attitude to the next by the shortest way, and rest at each."""
    from gnomon.geometry.rotations import rotvec_from_rotation

    frames: list[Floats] = []
    for start, stop in zip(rotations, [*rotations[1:], rotations[0]], strict=True):
        frames += [start] * resting
        way = rotvec_from_rotation(start.T @ stop)
        share = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, turning + 1) / (turning + 1))
        frames += [start @ rotation_from_rotvec(part * way) for part in share]
    return frames


def page(points: Floats) -> Floats:
    """Return points (..., 3) of the table on the page (..., 2), y down."""
    return (points @ LOOK.T)[..., :2] * (SCALE, -SCALE) + (SIZE / 2, SIZE / 2 + 14)


def animated(tag: str, attribute: str, values: Sequence[str], seconds: float, style: str, *, jump: bool = False) -> str:
    """Return an element whose attribute takes one value after the other; `jump` without steps between."""
    mode = ' calcMode="discrete"' if jump else ""
    return (
        f'<{tag} {attribute}="{values[0]}" {style}><animate attributeName="{attribute}" dur="{seconds:g}s" '
        f'repeatCount="3" fill="freeze"{mode} values="{";".join(values)}"/></{tag}>'
    )


def corners(points: Floats) -> str:
    """Return points (n, 3) of the table as those of an element of SVG."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in page(points))


def box(frames: Sequence[Floats], seconds: float, places: Sequence[Floats] | None = None, size: float = 1.0) -> str:
    """Return the faces of the box; those that look away are hidden from frame to frame."""
    places = [np.zeros(3)] * len(frames) if places is None else places
    parts: list[str] = []
    for name, face in FACES.items():
        shape = [corners(p + size * BOX[list(face)] @ R.T) for R, p in zip(frames, places, strict=True)]
        normal = (-1 if name[0] == "-" else 1) * np.eye(3)["xyz".index(name[-1])]
        seen = ["1" if (LOOK @ R @ normal)[2] > 0 else "0" for R in frames]
        fill = f'fill="{COLORS[name[-1]]}" fill-opacity="{0.4 if name[0] == "-" else 0.85}" stroke="#ffffff"'
        polygon = animated("polygon", "points", shape, seconds, fill)
        parts.append(animated("g", "opacity", seen, seconds, "", jump=True).replace("</g>", f"{polygon}</g>"))
    return "".join(parts)


def svg(name: str, title: str, body: str) -> None:
    """Write a drawing above the table."""
    ground = corners(1.55 * np.array([[-1, -1, -0.36], [1, -1, -0.36], [1, 1, -0.36], [-1, 1, -0.36]]))
    (FOLDER / f"{name}.svg").write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIZE} {SIZE}" width="{SIZE}" height="{SIZE}" '
        f'role="img" aria-label="{title}"><title>{title}</title>'
        f'<polygon points="{ground}" fill="#8a949e" fill-opacity="0.14"/>'
        f"{body}</svg>\n",
        encoding="utf-8",
    )


def six_faces() -> None:
    """Draw each face up once."""
    turns = [[0, 0, 0], [90, 0, 0], [180, 0, 0], [-90, 0, 0], [0, 90, 0], [0, -90, 0]]
    frames = between([rotation_from_rotvec(np.radians(turn)) for turn in turns], 8, 8)
    svg("six-faces", "A box is put on each of its six faces and rests there.", box(frames, len(frames) / 10))


def many_attitudes() -> None:
    """Draw attitudes all round, about changing axes."""
    rng = np.random.default_rng(4)
    turns = [rotation_from_rotvec(np.radians(rng.uniform(-150, 150, 3))) for _ in range(8)]
    frames = between(turns, 8, 7)
    svg(
        "many-attitudes",
        "A box is turned about changing axes and rests in each new attitude.",
        box(frames, len(frames) / 10),
    )


def waving(rig: Callable[[float], tuple[Floats, Floats]]) -> None:
    """Draw a camera that is turned about all axes and moved to and fro before the board."""
    time = np.linspace(0, 1, 72)
    eye = np.array([[0, 0, 0], [-0.42, 0.7, 0.3], [0.42, 0.7, 0.3], [0.42, 0.7, -0.3], [-0.42, 0.7, -0.3]])
    views = [p + eye @ R.T for R, p in map(rig, time.tolist())]
    side = 0.3
    squares = [(x, z) for i, x in enumerate(np.arange(-0.9, 0.9, side)) for z in np.arange(-0.2, 1.0, side)[i % 2 :: 2]]
    square = side * np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]])
    board = "".join(f'<polygon points="{corners(square + np.array([x, 1.5, z]))}" fill="#17202a"/>' for x, z in squares)
    lines = [[0, 1, 2, 0, 3, 4, 0], [1, 4], [2, 3]]
    style = 'fill="none" stroke="#0072b2" stroke-width="2.5" stroke-linejoin="round"'
    drawn = "".join(animated("polyline", "points", [corners(v[line]) for v in views], 6, style) for line in lines)
    svg("wave-the-rig", "A camera before a board is turned about all three axes and moved to and fro.", board + drawn)


def hand(t: float) -> tuple[Floats, Floats]:
    """Return attitude and place of the hand at a share of the animation."""
    w = 2 * np.pi * t
    turn = np.radians([22 * np.sin(3 * w), 24 * np.sin(4 * w + 1), 22 * np.sin(2 * w + 2)])
    place = np.array([0.5 * np.sin(2 * w), -1.0 + 0.3 * np.sin(3 * w + 1), 0.35 + 0.35 * np.sin(4 * w)])
    return rotation_from_rotvec(turn), place


def record_player() -> None:
    """Draw a sensor that rides on the platter of a record player."""
    time = np.linspace(0, 2 * np.pi, 49)
    ring = 1.5 * np.stack([np.cos(time), np.sin(time), np.full(49, -0.2) / 1.5], axis=1)
    frames = [rotation_from_rotvec(np.array([0, 0, -angle])) for angle in time.tolist()]
    small = [np.array([0.8 * np.cos(-a), 0.8 * np.sin(-a), 0.0]) for a in time.tolist()]
    mark = [corners(np.stack([np.zeros(3), 1.5 * R[:, 1]]) - (0, 0, 0.19)) for R in frames]
    platter = f'<polygon points="{corners(ring)}" fill="#17202a" fill-opacity="0.8"/>'
    line = animated("polyline", "points", mark, 1.8, 'stroke="#f0b94a" stroke-width="3"')
    ride = platter + line + box(frames, 1.8, small, size=0.45)
    svg("record-player", "A sensor rides on a record player at constant speed.", ride)


def draw_all() -> None:
    """Draw all of them."""
    FOLDER.mkdir(exist_ok=True)
    six_faces()
    many_attitudes()
    waving(hand)
    record_player()


if __name__ == "__main__":
    draw_all()
