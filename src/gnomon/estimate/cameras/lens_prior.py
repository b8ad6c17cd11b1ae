"""What any lens is like: a prior far wider than that, which only holds what the views leave open."""

import numpy as np

from ...frozen import value_class
from ...models.camera import Camera
from ...recording import Floats

_ORDER = {"k1": 2, "k2": 4, "k3": 6, "k4": 8, "p1": 1, "p2": 1}  # power of the radius beside the radius itself
_SHAPE_SIGMA = 1.0  # of xi, alpha, beta and w
_MIDDLE_SIGMA = 0.5  # of the principal point, over the width of the image


@value_class
class LensPrior:
    """A normal prior of a lens's parameters.

    Attributes
    ----------
    mean, sigma : (q,) in the order of `Camera.parameters`
    """

    mean: Floats
    sigma: Floats


def image_wide_prior(camera: Camera, pixels: Floats) -> LensPrior:
    """Return a prior as wide as the image itself: a distortion of 100 % at its border, a focal length of 100 %.

    Parameters
    ----------
    camera : about right
    pixels : (m, 2) where corners were seen [px]
    """
    width, height = camera.resolution
    fu, fv = camera.intrinsics[-4:-2]
    middle = np.array([width - 1, height - 1]) / 2
    # The focal length divides by the scale of the shape: the border lies at about one, be the lens narrow or wide.
    reach = float(np.max(np.linalg.norm((pixels - middle) / (fu, fv), axis=1), initial=0.1))
    sigma: list[float] = []
    mean = camera.parameters.copy()
    for k, (symbol, kind) in enumerate(zip(camera.parameter_symbols, camera.parameter_kinds, strict=True)):
        if kind == "focal":
            sigma.append(float(camera.parameters[k]))
        elif kind == "principal":
            mean[k] = middle[int(symbol == "pv")]
            sigma.append(_MIDDLE_SIGMA * width)
        elif symbol in _ORDER:
            mean[k] = 0.0
            sigma.append(reach ** -_ORDER[symbol])
        else:
            sigma.append(_SHAPE_SIGMA)
    return LensPrior(mean=mean, sigma=np.array(sigma))
