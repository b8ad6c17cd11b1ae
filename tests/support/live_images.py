"""Images and views of a board for tests of guided captures."""

from dataclasses import replace

import numpy as np

from gnomon.assess.checks.image_checks import measure_image
from gnomon.detect.boards.board import BoardView

GREY = np.random.default_rng(1).normal(120, 40, (48, 64)).clip(0, 255).astype(np.uint8)
STATISTICS = replace(measure_image(GREY), size=(640, 480), low=20.0, high=200.0, blur_px=0.7, clipped=0.0)


def views_of(simulation):
    """Yield what a detector finds in each frame of a simulated recording."""
    frames = simulation.recording.cameras["cam0"]
    for k in range(len(frames.t_ns)):
        own = frames.frame == k
        sigma = np.full(int(own.sum()), 0.15)
        yield BoardView(
            point=frames.point[own], pixels=frames.pixels[own], sigma_px=sigma, blur_px=0.7, black=20.0, white=200.0
        )
