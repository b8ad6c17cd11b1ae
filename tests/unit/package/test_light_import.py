"""Start-up stays light: nothing heavy is imported before it is needed."""

import json
import subprocess
import sys

import pytest

HEAVY = (
    *("numpy", "numpy.random", "numpy.f2py", "scipy", "scipy.stats", "scipy.linalg"),
    *("matplotlib", "jinja2", "yaml", "cattrs", "rich"),
)


def loaded_after(code):
    probe = f"import json, sys\n{code}\nprint(json.dumps([m for m in {HEAVY} if m in sys.modules]))"
    result = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    return json.loads(result.stdout.splitlines()[-1])


def test_importing_the_package_loads_nothing_heavy():
    assert loaded_after("import gnomon") == []


@pytest.mark.parametrize(
    ("arguments", "needed"), [(["--help"], []), (["imu", "--help"], []), (["simulate", "--help"], [])]
)
def test_help_needs_no_numbers(arguments, needed):
    assert loaded_after(f"from gnomon.cli import main\nassert main({arguments!r}) == 0") == needed


def test_calibrating_verifying_and_converting_need_neither_scipy_nor_matplotlib(tmp_path):
    loaded = loaded_after(
        "import gnomon\n"
        "from gnomon.cli import main\n"
        f"assert main(['simulate', '-o', {str(tmp_path / 'r.npz')!r}, '--intervals', '20']) == 0\n"
        f"assert main(['imu', {str(tmp_path / 'r.npz')!r}, '-o', {str(tmp_path / 'out')!r}, '--no-report']) == 0\n"
        f"result, fresh = {str(tmp_path / 'out' / 'calibration.yaml')!r}, {str(tmp_path / 'fresh.npz')!r}\n"
        "assert main(['simulate', '-o', fresh, '--intervals', '12', '--seed', '1', '--sensor-seed', '0']) == 0\n"
        "assert main(['verify', result, fresh, '--no-report']) in (0, 4)\n"
        f"assert main(['convert', result, '--to', 'px4', '-o', {str(tmp_path / 'imu.params')!r}]) == 0"
    )
    assert "numpy" in loaded
    assert not {"scipy", "matplotlib", "jinja2", "rich"} & set(loaded)


def test_every_public_name_is_there():
    import gnomon

    for name in gnomon.__all__:
        assert getattr(gnomon, name) is not None
    assert callable(gnomon.simulate)
    with pytest.raises(AttributeError, match="nothing_like_this"):
        _ = gnomon.nothing_like_this


def test_tables_and_comparisons_need_no_random_numbers():
    loaded = loaded_after("import gnomon.writers.tables, gnomon.assess.comparison.candidates")
    assert "numpy" in loaded
    assert "numpy.random" not in loaded


def test_a_rig_needs_of_scipy_only_the_routines_of_lapack():
    loaded = loaded_after("import gnomon.calibrate.camera_imu")
    assert "scipy" in loaded
    assert not {"scipy.stats", "scipy.linalg", "numpy.f2py"} & set(loaded)
