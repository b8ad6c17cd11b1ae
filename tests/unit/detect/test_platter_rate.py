"""The rate of a turning platter from a video: against the truth, hard videos, and those that show no rate."""

import tracemalloc

import numpy as np
import pytest

import platter_videos
from gnomon.calibrate.platter_rate import rate_from_video
from gnomon.detect.platter.period import read_pictures
from gnomon.detect.platter.rate import platter_rate
from gnomon.detect.platter.steady import DeviationMeans, PhaseLine, even_rate, longest_run, steady_blocks
from gnomon.detect.platter.turn import missing_frames, rate_by_jitter, stamps_are_nominal
from gnomon.errors import DetectionError, OptionError, RecordingError
from gnomon.recording.recording import Frame, ImageStream
from gnomon.simulate.images.platter_video import simulate_platter_video
from gnomon.writers.image_folders import save_video
from platter_videos import HARD, HOPELESS, RPM, scenario

OPEN = ("print of twelve parts",)
"""Of these the picture leaves several rates open."""

QUICK = ("starts and stops", "hidden by a hand", "print of two halves", "frames missing, unnoticed")
"""Hard videos for every day; all of them are a study."""


def checked(video, **options):
    """Return the rate, which must be the truth within three sigma."""
    found = platter_rate(video.stream(), **options)
    truth = abs(video.rate_rad_s)
    assert abs(found.rate_rad_s - truth) < 3 * found.sigma_rad_s
    return found


@pytest.fixture(scope="module")
def usual():
    """Return a minute at 15 frames per second and 16 rpm, blurred, noisy, and with uneven times."""
    return simulate_platter_video(scenario(wow=1e-4, jitter_s=0.004, exposure_s=0.05), seed=1)


def test_a_minute_of_a_webcam(usual):
    found = checked(usual)
    assert abs(found.rate_rad_s / usual.rate_rad_s - 1) < 1e-4
    assert found.sigma_rad_s / found.rate_rad_s < 1e-4
    assert found.turns == pytest.approx(16, abs=0.1)
    assert found.frames == found.frames_used == 900
    assert found.per_turn == 1
    assert np.std(found.phase_turns) < 1e-3
    best = found.periods_s[np.argmax(found.scores)]
    assert best == pytest.approx(2 * np.pi / usual.rate_rad_s, rel=0.01)
    assert [finding.code for finding in found.findings] == ["platter-even"]


def test_memory_stays_bounded():
    """A picture of every frame is kept in two bytes a cell, and the images are not."""
    image = np.random.default_rng(0).integers(0, 255, (480, 640), dtype=np.uint8)
    frames = 300

    def stream(_):
        for number in range(frames):
            yield Frame(t_ns=number * 66_000_000, where="", decode=lambda: image)

    tracemalloc.start()
    read_pictures(ImageStream(frames=stream))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.15 * frames * image.size


@pytest.mark.first(2)
@pytest.mark.parametrize("name", QUICK)
def test_hard_videos(name):
    video = simulate_platter_video(scenario(**HARD[name]), seed=3)
    found = checked(video)
    assert found.sigma_rad_s / found.rate_rad_s < 2e-3
    codes = {finding.code for finding in found.findings}
    if name == "starts and stops":
        assert video.steady_s[0] - 5 < found.steady_s[0]
        assert found.steady_s[1] < video.steady_s[1]
        assert "platter-steady-part" in codes
    if name == "print of two halves":
        assert found.per_turn == 2
        assert "platter-pattern" in codes
    if name == "frames missing, unnoticed":
        assert {"video-frames-missing", "video-nominal-times"} <= codes


@pytest.mark.slow
@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("seed", [1, 2])
def test_all_hard_videos(name, seed):
    video = simulate_platter_video(scenario(**HARD[name]), seed=seed)
    found = checked(video, nominal_rad_s=abs(video.rate_rad_s) if name in OPEN else None)
    assert found.sigma_rad_s / found.rate_rad_s < 6e-3


@pytest.mark.parametrize("name", ["at rest", "swings", "five frames a second"])
def test_videos_without_a_rate(name):
    options, words = HOPELESS[name]
    options = {"duration_s": 15.0 if name == "swings" else 30.0} | options
    with pytest.raises(DetectionError, match=words):
        platter_rate(simulate_platter_video(scenario(**options), seed=2).stream())


@pytest.mark.slow
@pytest.mark.parametrize("name", HOPELESS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_all_videos_without_a_rate(name, seed):
    options, words = HOPELESS[name]
    with pytest.raises(DetectionError, match=words):
        platter_rate(simulate_platter_video(scenario(**options), seed=seed).stream())


def test_the_nominal_rate_decides():
    options, _ = HOPELESS["five frames a second"]
    video = simulate_platter_video(scenario(**options), seed=2)
    found = checked(video, nominal_rad_s=16.5 * RPM)
    assert found.clock == 1e-3
    with pytest.raises(DetectionError, match=r"once in a turn of the platter, at 1[56]\.?\d* rpm; that does not agree"):
        platter_rate(video.stream(), nominal_rad_s=45 * RPM)
    with pytest.raises(OptionError, match="must be positive"):
        platter_rate(video.stream(), nominal_rad_s=0.0)


def test_turns_that_pass_between_frames_show_by_irregular_times():
    options = {"rate_rad_s": 78 * RPM, "frame_rate_hz": 1.7, "exposure_s": 0.01, "jitter_s": 0.01}
    video = simulate_platter_video(scenario(**options), seed=3)
    assert checked(video, nominal_rad_s=80 * RPM).turns == pytest.approx(77, abs=1)


def test_a_platter_that_stopped_meanwhile_is_not_bridged():
    whole = simulate_platter_video(scenario(duration_s=40.0), seed=5)
    images = list(whole.images())
    shown = np.r_[np.arange(300), np.full(40, 300), np.arange(300, 560)]  # 0.71 turns are lost
    rng = np.random.default_rng(0)
    t_ns = np.cumsum(rng.integers(65_000_000, 68_000_000, len(shown)))

    def frames(_):
        for stamp, number in zip(t_ns.tolist(), shown.tolist(), strict=True):
            noise = rng.normal(0, 2, images[number].shape)
            picture = np.clip(images[number] + noise, 0, 255).astype(np.uint8)
            yield Frame(t_ns=stamp, where="", decode=lambda picture=picture: picture)

    found = platter_rate(ImageStream(frames=frames))
    assert found.steady_s[1] - found.steady_s[0] < 21.5
    turning = whole.rate_rad_s / 15 / np.median(np.diff(t_ns) * 1e-9)
    assert abs(found.rate_rad_s / turning - 1) < 0.01


# ---- files ----


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """Return a short video and the file of it."""
    video = simulate_platter_video(scenario(duration_s=20.0, rate_rad_s=45 * RPM), seed=7)
    path = tmp_path_factory.mktemp("videos") / "platter.mkv"
    assert save_video(path, video.images(), video.t_ns) == len(video.t_ns)
    return video, path


def test_a_file(short):
    video, path = short
    said = []
    found = rate_from_video(path, progress=said.append)
    assert abs(found.rate_rad_s - video.rate_rad_s) < 3 * found.sigma_rad_s
    assert found.sigma_rad_s / found.rate_rad_s < 3e-4
    assert said[0].startswith("looking at the images: 0 of 300")


def test_a_file_with_even_times_and_a_table_beside_it(short, tmp_path):
    video, _ = short
    path = tmp_path / "platter.avi"
    save_video(path, video.images(), video.t_ns, codec="mjpeg")
    found = rate_from_video(path)
    assert found.clock == 1e-3
    assert "video-nominal-times" in [finding.code for finding in found.findings]
    (tmp_path / "platter.csv").write_text("timestamp [ns]\n" + "".join(f"{t}\n" for t in video.t_ns))
    (tmp_path / "platter_imu.csv").write_text("this is no recording\n")
    better = rate_from_video(path)
    assert better.clock < 1e-4
    assert abs(better.rate_rad_s - video.rate_rad_s) < 3 * better.sigma_rad_s


def test_a_truncated_file_is_used_as_far_as_it_goes(short, tmp_path):
    video, path = short
    (tmp_path / "cut.mkv").write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 5])
    found = rate_from_video(tmp_path / "cut.mkv")
    assert found.duration_s < 15
    assert abs(found.rate_rad_s - video.rate_rad_s) < 3 * found.sigma_rad_s
    assert "video-damaged" in [finding.code for finding in found.findings]


def test_files_that_are_no_videos(tmp_path):
    (tmp_path / "notes.txt").write_text("33 rpm\n")
    with pytest.raises(RecordingError, match="this is no video"):
        rate_from_video(tmp_path / "notes.txt")
    with pytest.raises(RecordingError, match="there is no such file"):
        rate_from_video(tmp_path / "missing.mkv")
    (tmp_path / "noise.mp4").write_bytes(np.random.default_rng(1).bytes(5000))
    with pytest.raises(RecordingError, match="no video, or it is damaged"):
        rate_from_video(tmp_path / "noise.mp4")


# ---- parts ----


def test_stamps_are_nominal():
    even = np.arange(300) / 15
    assert stamps_are_nominal(even)
    assert stamps_are_nominal(np.round(even, 3))  # Matroska
    assert stamps_are_nominal(np.delete(even, [17, 18, 200]))
    assert not stamps_are_nominal(even + np.random.default_rng(0).normal(0, 1e-3, 300))


def test_missing_frames():
    rng = np.random.default_rng(3)
    kept = np.setdiff1d(np.arange(400), [50, 51, 200, 330])
    phase = 0.11 * kept + rng.normal(0, 0.004, len(kept))
    t = np.arange(len(kept)) / 15
    missing, clearness = missing_frames(1 / 15, np.arange(len(kept)), t, phase)
    assert clearness > 9
    np.testing.assert_array_equal(missing, kept - np.arange(len(kept)))
    assert missing_frames(1 / 15, np.arange(len(kept)), t, phase + rng.normal(0, 0.05, len(kept)))[1] < 3.5


def test_rate_by_jitter():
    rng = np.random.default_rng(4)
    t = np.arange(600) / 15 + rng.normal(0, 2e-3, 600)
    extra = 2 * np.pi * 15
    off = extra * (t - np.arange(600) / 15) + rng.normal(0, 0.02, 600)
    slope, sigma = rate_by_jitter(t, off)
    assert abs(slope - extra) < 4 * sigma < 0.1 * extra
    assert rate_by_jitter(np.arange(600) / 15, off)[1] == np.inf


def blocks_of_walk(rng, own, walk, count=30):
    """Return blocks of a line with slope 0 and errors of both kinds."""
    off = rng.normal(0, own, count) + np.cumsum(rng.normal(0, walk, count))
    number = np.arange(count)
    return DeviationMeans(
        t_s=number + 0.5, off=off, variance=np.full(count, own**2), number=number, length_s=1.0, start_s=0.0
    )


@pytest.mark.parametrize(("own", "walk"), [(1e-3, 0.0), (1e-3, 1e-3), (1e-4, 3e-3)])
def test_the_sigma_of_an_even_rate_is_its_scatter(own, walk):
    rng = np.random.default_rng(5)
    line = PhaseLine(rate=2.0, phase=0.0)
    fits = [even_rate(line, blocks_of_walk(rng, own, walk)) for _ in range(150)]
    z = np.array([(fit.line.rate - 2.0) / fit.sigma for fit in fits])
    assert 0.3 < np.sqrt(np.mean(z**2)) < 1.15  # large where there is no walk, which the blocks cannot exclude
    assert np.mean(np.abs(z) > 3) < 0.03


def test_steady_blocks_leave_the_spin_up_out():
    rng = np.random.default_rng(6)
    number = np.arange(40)
    off = rng.normal(0, 1e-3, 40) - 0.5 * np.exp(-number / 2.0)
    blocks = DeviationMeans(
        t_s=number + 0.5, off=off, variance=np.full(40, 1e-6), number=number, length_s=1.0, start_s=0.0
    )
    kept = steady_blocks(blocks)
    assert kept[-1] == 39
    assert 8 <= kept[0] <= 14


def test_the_longest_run():
    numbers = np.array([0, 1, 5, 6, 7, 8, 9, 11, 12, 40, 41])
    np.testing.assert_array_equal(longest_run(numbers), numbers[:9])
    assert len(longest_run(np.empty(0, np.int64))) == 0


def test_the_simulation_repeats_itself_and_refuses_nonsense():
    one, other = (simulate_platter_video(scenario(duration_s=1.0), seed=9) for _ in range(2))
    np.testing.assert_array_equal(list(one.images()), list(other.images()))
    np.testing.assert_array_equal(one.t_ns, other.t_ns)
    for wrong in ({"duration_s": 0.0}, {"dropped": 1.0}, {"symmetry": 0}, {"tilt_deg": 85.0}, {"noise_grey": -1.0}):
        with pytest.raises(OptionError, match=next(iter(wrong))):
            platter_videos.scenario(**wrong)
