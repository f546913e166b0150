"""run, estimate and their verdicts: the numbers of the commands, against the truth of the bundled experiment."""

import csv
import signal
import threading

import numpy as np
import pandas
import pytest
from conftest import BENDING, columns

import snakeloop


def header(path):
    with open(path, newline="") as file:
        return next(csv.reader(file))


@pytest.fixture(scope="module")
def run():
    return snakeloop.run(BENDING)


def test_a_run_measures_and_learns_and_writes_the_commands_files(run):
    truth = columns(BENDING / "truth.csv")
    measured = run.measurements
    assert list(measured) == header(run.out / "measurements.csv")
    np.testing.assert_array_equal(measured["index"], truth["index"])
    assert set(measured["status"]) == {"ok"}
    off = (measured["theta_deg"] - truth["theta_deg"]) / measured["sigma_theta_deg"]
    assert np.sqrt(np.mean(off**2)) < 2
    assert run.verdict.level == "good" and "compensation.csv" in [path.name for path in run.out.iterdir()]
    assert (run.eta, run.lambda_mm) == (run.model.eta, run.model.lambda_mm)
    written = snakeloop.Model.read(run.out / "model.toml")
    assert abs(written.eta - run.eta) < 1e-12 and written.robot == run.model.robot
    assert str(run).startswith("verdict: good\nframes measured  17 of 17") and "good" in repr(run)
    assert "Good: nothing speaks" in run._repr_html_()


def test_a_folder_that_is_named_is_written_to_and_a_temporary_one_goes_with_its_run(tmp_path, run):
    named = snakeloop.run(str(BENDING / "experiment.toml"), tmp_path / "out")
    assert named.out == tmp_path / "out" and named.eta == run.eta
    for name in ["measurements.csv", "estimate.csv", "compensation.csv"]:
        assert (named.out / name).read_text() == (run.out / name).read_text()
    temporary = snakeloop.run(BENDING).out
    assert not temporary.exists()


def test_an_estimate_is_the_runs_from_files_frames_and_dicts(run):
    encoders = columns(BENDING / "encoders.csv")
    for measurements, log in [
        (run.out / "measurements.csv", BENDING / "encoders.csv"),
        (run.measurements, encoders),
        (pandas.DataFrame(run.measurements), pandas.DataFrame(encoders)),
    ]:
        found = snakeloop.estimate(measurements, log)
        np.testing.assert_allclose([found.eta, found.lambda_mm], [run.eta, run.lambda_mm], rtol=1e-9)
        assert found.verdict.level == "good" and found.covariance.shape == (2, 2)
        assert list(found.rows) == header(run.out / "estimate.csv")
        assert list(found.rows["index"]) == list(run.measurements["index"])
        assert found.rows["eta"][-1] == pytest.approx(found.eta, abs=1e-6)
        assert found.model == run.model and "verdict: good" in str(found)


def test_a_log_wired_wrongly_has_a_verdict_that_says_so(tmp_path):
    measurements, encoders, _ = snakeloop.simulate()
    swapped = encoders | {"q2_mm": encoders["q3_mm"], "q3_mm": encoders["q2_mm"]}
    verdict = snakeloop.estimate(measurements, swapped).verdict
    worst = verdict.reasons[0]
    assert verdict.level == "do_not_use" and worst["code"] == "wiring" and worst["text"] and worst["remedy"]
    assert worst["suggestion"]["columns"] == [1, 3, 2]
    assert str(verdict).startswith("verdict: do not use\n  - encoder log") and "do not use" in repr(verdict)
    assert "Do not use this result" in verdict._repr_html_()
    with pytest.raises(TypeError, match="neither true nor false"):
        bool(verdict)
    # The mark goes with the model, into its file, its table and whatever would start from it.
    model = snakeloop.estimate(measurements, swapped).model
    model.write(tmp_path / "bad.toml")
    with pytest.warns(UserWarning, match="must not be used"):
        again = snakeloop.Model.read(tmp_path / "bad.toml")
    for bad in (model, again):
        assert set(bad.table(theta_deg=[10.0], delta_deg=[0.0])["do_not_use"]) == {1}
        with pytest.raises(snakeloop.SnakeloopError, match="must not be used"):
            snakeloop.estimate(measurements, encoders, bad)


def test_measurements_that_tell_nothing_give_no_estimate_but_a_verdict(run):
    encoders = columns(BENDING / "encoders.csv")
    first = {name: column[:1] for name, column in run.measurements.items()}
    found = snakeloop.estimate(first, encoders)
    assert (found.eta, found.lambda_mm, found.covariance) == (None, None, None) and found.verdict.level != "good"


def test_measurements_without_sigmas_are_given_those_that_they_show(run):
    bare = {name: run.measurements[name] for name in ["index", "time_s", "theta_deg", "delta_deg", "status"]}
    with pytest.warns(UserWarning, match="17 measurements have no sigmas"):
        found = snakeloop.estimate(bare, BENDING / "encoders.csv")
    assert abs(found.eta - run.eta) < 0.05


def test_what_cannot_be_run_says_why(tmp_path):
    with pytest.raises(snakeloop.SnakeloopError, match="nowhere"):
        snakeloop.run(tmp_path / "nowhere")


def test_ctrl_c_ends_a_run(tmp_path):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        timer = threading.Timer(0.5, signal.raise_signal, (signal.SIGINT,))
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            snakeloop.run(BENDING, tmp_path / "out")
            pytest.fail("it was done before it could be interrupted")
        timer.join()
    finally:
        signal.signal(signal.SIGINT, before)
    assert not (tmp_path / "out" / "report.html").exists()


def test_the_table_is_that_of_the_command(run):
    file = columns(run.out / "compensation.csv")
    table = run.model.table()
    assert list(table) == list(file)
    for name, column in table.items():
        np.testing.assert_allclose(column, file[name], atol=1e-6)
    table = run.model.table(theta_deg=[0, 30, 110], delta_deg=np.array([-90.0, 0.0]))
    np.testing.assert_allclose(table["theta_deg"], [0, 0, 30, 30, 110, 110], atol=1e-9)
    np.testing.assert_allclose(table["delta_deg"], 3 * [-90, 0], atol=1e-9)
    commands = np.stack([table[f"qc{i}_mm"] for i in (1, 2, 3)], axis=1)
    expected = run.model.command(theta_deg=table["theta_deg"], delta_deg=table["delta_deg"])
    np.testing.assert_allclose(commands, expected, atol=1e-12)
    assert list(table["extrapolated"][-2:]) == [1, 1] and (table["sd_qc1_mm"] > 0).all()
    with pytest.raises(snakeloop.SnakeloopError, match="outside the workspace"):
        run.model.table(theta_deg=[130], delta_deg=[0])


def test_sigmas_that_somebody_changed_count_and_not_the_covariance_beside_them(run):
    widened = run.measurements | {"sigma_theta_deg": 3 * run.measurements["sigma_theta_deg"]}
    without = {name: column for name, column in widened.items() if not name.startswith("var_")}
    encoders = BENDING / "encoders.csv"
    own, of_sigmas, of_widened = (snakeloop.estimate(table, encoders).eta for table in (run.measurements, without, widened))
    assert of_widened == of_sigmas != own
