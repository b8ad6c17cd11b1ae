"""What a use needs: built-in uses, files, and one clear error for what makes no sense."""

import numpy as np
import pytest

from gnomon.errors import FormatError, OptionError
from gnomon.formats.own.dataclass_file import read_use
from gnomon.options.requirements import QUANTITIES, USES, parse_sigma


def test_units_are_those_that_people_use():
    assert parse_sigma("camera_rotation", "0.1 deg") == pytest.approx(np.radians(0.1))
    assert parse_sigma("camera_rotation", "2 mrad") == pytest.approx(2e-3)
    assert parse_sigma("camera_translation", "5 mm") == pytest.approx(5e-3)
    assert parse_sigma("gyroscope_scale", "0.1%") == parse_sigma("gyroscope_scale", "0.1 %") == pytest.approx(1e-3)
    assert parse_sigma("accelerometer_bias", "2 mg") == pytest.approx(2e-3 * 9.80665)
    assert parse_sigma("gyroscope_g_sensitivity", "0.05 deg/s/g") == pytest.approx(np.radians(0.05) / 9.80665)


@pytest.mark.parametrize("use", USES.values(), ids=lambda use: use.name)
def test_built_in_uses_name_known_quantities(use):
    assert use.needs
    assert set(use.needs) <= set(QUANTITIES)
    assert all(value > 0 for value in use.needs.values())


def test_a_file_states_a_use_of_its_own(tmp_path):
    path = tmp_path / "drone.yaml"
    path.write_text("name: mapping drone\ncamera_rotation: 0.05 deg\ntime_shift: 0.2 ms\nfails_at: 5\n")
    use = read_use(path)
    assert (use.name, use.fails_at) == ("mapping drone", 5.0)
    assert dict(use.needs) == pytest.approx({"camera_rotation": np.radians(0.05), "time_shift": 2e-4})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("camera_rotaton: 0.1 deg", "camera_rotaton: unknown key. Did you mean camera_rotation?"),
        ("camera_rotation: 0.1 mm", 'found "0.1 mm", expected a number above zero and its unit'),
        ("camera_rotation: 0.1", 'found "0.1", expected a number above zero and its unit'),
        ("camera_rotation: -1 deg", "expected a number above zero"),
        ("camera_rotation: inf deg", "expected a number above zero"),
        ("name: empty", "no quantity is stated"),
        ("time_shift: 1 ms\nfails_at: 1", "fails_at: found 1, expected a number above 1"),
        ("- 1", "expected keys and values"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(tmp_path, text, said):
    path = tmp_path / "use.yaml"
    path.write_text(text)
    with pytest.raises(FormatError) as error:
        read_use(path)
    assert said in str(error.value)
    assert str(path) in str(error.value)


def test_an_unknown_use_is_named_with_the_known_ones():
    with pytest.raises(OptionError, match=r"'vo'.*Did you mean vio\?.*ahrs.*YAML"):
        read_use("vo")
    with pytest.raises(FormatError, match="no such file"):
        read_use("nowhere.yaml")
