"""How good a detector of boards is: what it finds of what is visible, and where."""

import csv
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gnomon.detect.boards.board import BoardView
from gnomon.models.target import Target
from gnomon.recording import Floats, Integers
from gnomon.recording.recording import Grey

WRONG_PX, WRONG = 2.0, 0.25
"""A corner that is farther than both from where it truly is, in px and in tags, is a wrong one."""


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What is true of one image."""

    image: Grey
    target: Target
    visible: Integers
    """numbers of the points that a detector can find"""
    projected: Floats
    """(n, 2) all points of the board"""
    tags: Integers
    tag_px: float
    blur_px: float = float("nan")
    noise: float = float("nan")


@dataclass(kw_only=True)
class Score:
    """Sums over images."""

    images: int = 0
    visible: int = 0
    found: int = 0
    tags: int = 0
    tags_found: int = 0
    wrong: int = 0
    whole_boards: int = 0
    errors: list[Floats] = field(default_factory=list)
    sigmas: list[Floats] = field(default_factory=list)

    def add(self, truth: Truth, view: BoardView) -> None:
        error = view.pixels - truth.projected[view.point]
        with np.errstate(invalid="ignore"):
            good = np.linalg.norm(error, axis=1) <= max(WRONG_PX, WRONG * np.nan_to_num(truth.tag_px))
        self.images += 1
        self.wrong += int(np.count_nonzero(~good))
        self.visible += len(truth.visible)
        hit = np.isin(truth.visible, view.point[good])
        self.found += int(np.count_nonzero(hit))
        self.whole_boards += bool(hit.all())
        if truth.target.kind == "aprilgrid":
            corners = truth.target.point_of_tag_corner(truth.tags[:, None], np.arange(4))
            self.tags += len(truth.tags)
            self.tags_found += int(np.count_nonzero(np.isin(corners, view.point[good]).all(axis=1)))
        self.errors.append(error[good])
        self.sigmas.append(view.sigma_px[good])

    @property
    def error(self) -> Floats:
        return np.concatenate(self.errors) if self.errors else np.zeros((0, 2))

    @property
    def recall(self) -> float:
        """Of the tags that are visible as a whole, or of the corners where there are none."""
        if self.tags:
            return self.tags_found / self.tags
        return self.found / self.visible if self.visible else float("nan")

    @property
    def corner_recall(self) -> float:
        return self.found / self.visible if self.visible else float("nan")

    @property
    def rms(self) -> Floats:
        """Per axis [px]."""
        return np.sqrt(np.mean(self.error**2, axis=0)) if len(self.error) else np.full(2, np.nan)

    @property
    def bias(self) -> Floats:
        return self.error.mean(axis=0) if len(self.error) else np.full(2, np.nan)

    @property
    def z_rms(self) -> float:
        """Root mean square of the errors over the detector's own standard deviations."""
        if not len(self.error):
            return float("nan")
        return float(np.sqrt(np.mean((self.error / np.concatenate(self.sigmas)[:, None]) ** 2)))

    @property
    def z_beyond_3(self) -> float:
        """Fraction of the errors that are larger than 3 standard deviations; 0.0027 of a normal distribution."""
        if not len(self.error):
            return float("nan")
        return float(np.mean(np.abs(self.error) > 3 * np.concatenate(self.sigmas)[:, None]))


def with_truth(folder: Path, target: Target, *, border_px: float = 5.0) -> list[Truth]:
    """Return the images of a recording in rendered-camimu, with the exact corners that stand beside them."""
    import cv2

    rows: dict[str, list[tuple[int, float, float]]] = {}
    with (folder / "true_corners.csv").open() as file:
        for stamp, point, u, v, *_ in list(csv.reader(file))[1:]:
            rows.setdefault(stamp, []).append((int(point), float(u), float(v)))
    found: list[Truth] = []
    for stamp, corners in sorted(rows.items()):
        image = cv2.imread(str(folder / f"{stamp}.png"), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        table = np.array(corners)
        projected = np.full((len(target), 2), np.nan)
        projected[table[:, 0].astype(int)] = table[:, 1:]
        with np.errstate(invalid="ignore"):
            inside = (projected >= border_px) & (projected <= np.array(image.shape[::-1]) - 1 - border_px)
        visible = inside.all(axis=1)
        tags = np.empty(0, np.int64)
        if target.kind == "aprilgrid":
            at = target.point_of_tag_corner(np.arange(target.tags)[:, None], np.arange(4))
            tags = np.flatnonzero(visible[at].all(axis=1))
        side = float(np.nanmedian(np.linalg.norm(projected[1::2] - projected[::2][: len(projected) // 2], axis=1)))
        found.append(
            Truth(
                image=image,
                target=target,
                visible=np.flatnonzero(visible),
                projected=projected,
                tags=tags,
                tag_px=side,
            )
        )
    return found
