"""Lens, Rig, Eye and Estimator on the bundled experiment, whose truth is known."""

import numpy as np
import pytest
from conftest import BENDING, columns

import snakeloop


def test_every_frame_is_measured_as_well_as_its_sigmas_say(measured):
    truth = columns(BENDING / "truth.csv")
    assert [m.status for m in measured] == ["ok"] * len(truth["index"])
    z = [(m.theta_deg - theta) / m.sigma_theta_deg for m, theta in zip(measured, truth["theta_deg"], strict=True)]
    # The mean square of 17 is below 3 but once in 10,000.
    assert np.mean(np.square(z)) < 3 and max(abs(m.theta_deg - t) for m, t in zip(measured, truth["theta_deg"])) < 0.2
    for m in measured:
        np.testing.assert_allclose(np.sqrt(np.diag(m.covariance)), [m.sigma_theta_deg, m.sigma_delta_deg])


def test_the_estimator_gives_what_the_program_gives(measured):
    encoders = columns(BENDING / "encoders.csv")
    q_mm = np.stack([encoders[f"q{i}_mm"] for i in (1, 2, 3)], axis=1)
    estimator = snakeloop.Estimator()
    assert estimator.eta is None and estimator.covariance is None
    steps = [estimator.update(m, q) for m, q in zip(measured, q_mm, strict=True)]
    assert {step.verdict for step in steps} == {"used"} and steps[-1].residual_mm.shape == (3,)
    # What `snakeloop run fixtures/bending` gives, whose JPEG decoder may differ by a grey level.
    assert estimator.eta == pytest.approx(1.2208, abs=2e-4) and estimator.lambda_mm == pytest.approx(0.1765, abs=1e-4)
    assert np.sqrt(estimator.covariance[0, 0]) == pytest.approx(0.0012, abs=1e-4)
    assert estimator.model.eta == estimator.eta
    # An outlier: the same pose read 2 mm off. A frame that was not measured is passed over.
    step = estimator.update(measured[0], q_mm[0] + [2.0, 0.0, 0.0])
    assert (step.verdict, step.reason) == ("rejected", "bend_outlier")


def test_a_pose_from_elsewhere_has_numbers():
    known = {"theta_deg": 30.0, "delta_deg": 10.0, "sigma_theta_deg": 0.1, "sigma_delta_deg": 0.2}
    measurement = snakeloop.Measurement(**known)
    assert {name: pytest.approx(getattr(measurement, name)) for name in known} == known and measurement.status == "ok"
    for name, value in [("theta_deg", np.nan), ("delta_deg", np.inf), ("sigma_theta_deg", 0.0)]:
        with pytest.raises(snakeloop.SnakeloopError, match=name):
            snakeloop.Measurement(**known | {name: value})


def test_depth_and_layout_of_the_array_do_not_matter(eye, frames):
    frame = frames[3]
    expected = eye.measure(frame)
    mirrored_twice = np.ascontiguousarray(frame[:, ::-1])[:, ::-1]
    assert not mirrored_twice.flags.c_contiguous
    for same in [frame.astype(np.uint16) * 257, np.asfortranarray(frame), mirrored_twice]:
        found = eye.measure(same)
        assert (found.theta_deg, found.delta_deg) == pytest.approx((expected.theta_deg, expected.delta_deg), abs=1e-5)
    grey = frame.mean(axis=2).astype(np.uint8)
    assert eye.measure(grey).status == eye.measure(grey[:, :, None]).status


def test_what_is_no_picture_is_refused_and_what_is_no_snake_has_its_status(eye, frames):
    height, width, _ = frames[0].shape
    black = eye.measure(np.zeros((height, width), np.uint8))
    assert black.status != "ok" and np.isnan([black.theta_deg, black.sigma_delta_deg]).all()
    assert eye.measure(frames[0][:100]).status == "wrong_size"
    for wrong, why in [(frames[0] / 255.0, "array of float64"), ([[1]], "list"), (frames[0][None], "shape")]:
        with pytest.raises(snakeloop.SnakeloopError, match=why):
            eye.measure(wrong)


def test_a_rig_is_written_and_read_and_a_bad_picture_says_why(lens, rig, frames, tmp_path):
    rig.write(tmp_path / "rig.toml")
    again = snakeloop.Rig.read(tmp_path / "rig.toml")
    one, other = (snakeloop.Eye(lens, r).measure(frames[2]) for r in (rig, again))
    assert one.theta_deg == pytest.approx(other.theta_deg, abs=1e-6)
    with pytest.raises(snakeloop.SnakeloopError, match="rig calibration"):
        snakeloop.Rig.calibrate(np.zeros_like(frames[0]), lens, grid_pitch_mm=1.0, standoff_mm=25.0)
