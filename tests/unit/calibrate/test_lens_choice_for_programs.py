"""A lens that programs read is preferred where it is about as good; --for chooses among what one program reads."""

import numpy as np
import pytest

import gnomon
from gnomon.calibrate.steps.camera_lenses import chosen_lenses
from gnomon.cli import main
from gnomon.errors import OptionError
from gnomon.estimate.cameras.rig import gathered_views
from gnomon.models.lens_names import PROGRAMS, models_of, read_everywhere, refit_models
from gnomon.simulate.scenarios.cameras import CamerasScenario


@pytest.fixture(scope="module")
def eucm():
    """Views by a lens that is a eucm-none; equidistant is a hair worse."""
    return gnomon.simulate_cameras(CamerasScenario.with_lens("eucm-none", views=24), 5)


def choose(simulation, **options):
    views = gathered_views(simulation.recording.cameras, simulation.target)
    return chosen_lenses({"cam0": views}, {}, robust=True, most_iterations=30, **options)[0]


def test_what_every_program_reads_is_preferred_within_three_percent(eucm):
    choice = choose(eucm)
    px = {trial.model: trial.holdout_rms_px for trial in choice.trials}
    assert choice.lens.model == "pinhole-equidistant"
    assert px["pinhole-equidistant"] < 1.03 * min(px[model] for model in px if np.isfinite(px[model]))
    assert not choice.better


def test_a_model_that_predicts_much_worse_is_not_taken_for_being_read():
    simulation = gnomon.simulate_cameras(CamerasScenario.with_lens("pinhole-radtan5", views=30), 2)
    choice = choose(simulation)
    px = {trial.model: trial.holdout_rms_px for trial in choice.trials}
    assert px["pinhole-radtan"] > 1.03 * px["pinhole-radtan5"]
    assert choice.lens.model == "pinhole-radtan5"


def test_for_a_program_only_its_models_are_taken(eucm):
    choice = choose(eucm, among=("pinhole-radtan",))
    assert choice.lens.model == "pinhole-radtan"
    assert choice.better in ("eucm-none", "ds-none", "pinhole-equidistant")  # which is said, as of a stated one
    assert {trial.model for trial in choice.trials} >= {"eucm-none", "pinhole-radtan"}
    with pytest.raises(OptionError, match="there is no such lens"):
        choose(eucm, among=("pinhole-banana",))


def test_every_program_reads_a_model_that_every_program_reads():
    assert set(read_everywhere()) == {"pinhole-radtan", "pinhole-equidistant"}
    for name in PROGRAMS:
        assert set(refit_models(name)) <= set(models_of(name))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--for", "openvin"), "Did you mean openvins?"),
        (("--for", "openvins", "--model", "pinhole-radtan"), "chooses among"),
        (("--for", "vio"), "Uses such as vio are stated to gnomon camera-imu"),
    ],
)
def test_wrong_usage(words, message, tmp_path, capsys):
    assert main(["camera", str(tmp_path), *words]) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_a_program_where_a_use_is_stated(tmp_path, capsys):
    (tmp_path / "log.csv").touch()
    assert main(["imu", str(tmp_path / "log.csv"), "--for", "okvis"]) == 2
    assert "gnomon camera --for okvis chooses" in " ".join(capsys.readouterr().err.split())
