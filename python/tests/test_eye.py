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
    assert estimator.eta == pytest.approx(1.2206, abs=2e-4) and estimator.lambda_mm == pytest.approx(0.1765, abs=1e-4)
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
    with pytest.raises(snakeloop.SnakeloopError, match="robot: .*str.*expected a Robot or a Model"):
        snakeloop.Eye(lens, rig, robot="mine")


def test_a_lens_of_numbers_is_that_of_its_file(lens):
    text = (BENDING / "camera.yaml").read_text()
    K, dist = ([float(n) for n in block.split("]")[0].replace("\n", " ").split(",")] for block in text.split("data: [")[1:])
    assert snakeloop.Lens(np.reshape(K, (3, 3)), dist, (lens.width, lens.height)) == lens
    for without in ([], np.zeros(14)):
        assert snakeloop.Lens(np.reshape(K, (3, 3)), without, [lens.width, lens.height]) == lens
    assert snakeloop.Lens(np.reshape(K, (3, 3)), [-0.1, 0.02, 0, 0], (lens.width, lens.height)) != lens
    for numbers, why in [
        ((np.eye(2), [], (640, 480)), "K: shape .2, 2."),
        ((np.zeros((3, 3)), [], (640, 480)), "camera: K"),
        ((np.reshape(K, (3, 3)), [0.1] * 3, (640, 480)), "dist: 3 numbers"),
        ((np.reshape(K, (3, 3)), [], (0, 480)), "size"),
    ]:
        with pytest.raises(snakeloop.SnakeloopError, match=why):
            snakeloop.Lens(*numbers)


def test_a_robot_and_its_model_are_one_to_an_eye(lens, rig, frames, measured):
    robot = snakeloop.Robot()
    by_robot, by_model = (snakeloop.Eye(lens, rig, robot=robot).measure(frames[5]) for robot in (robot, snakeloop.Model(robot)))
    assert (by_robot.theta_deg, by_robot.delta_deg) == (by_model.theta_deg, by_model.delta_deg)
    assert snakeloop.Eye(lens, rig, robot=snakeloop.Robot(length_mm=40.0)).measure(frames[5]).status != "ok"


def test_a_sequence_is_tracked_to_the_same_angles(eye, frames, measured):
    for frame, expected in zip(frames, measured, strict=True):
        for near in [expected, (expected.theta_deg + 2, expected.delta_deg), (10.0, 0.0)]:
            found = eye.track(frame, near)
            assert found.status == "ok" and found.theta_deg == pytest.approx(expected.theta_deg, abs=0.05)
    lost = eye.measure(np.zeros(frames[0].shape[:2], np.uint8))
    assert eye.track(frames[3], lost).theta_deg == measured[3].theta_deg
    with pytest.raises(snakeloop.SnakeloopError, match="near: .*expected a Measurement or"):
        eye.track(frames[3], 30.0)


def test_what_was_measured_is_drawn_on_the_frame(eye, frames, measured):
    drawn = eye.overlay(frames[4], measured[4])
    assert drawn.shape == frames[4].shape and drawn.dtype == np.uint8
    changed = (drawn != frames[4]).any(axis=2)
    assert 0.005 < changed.mean() < 0.3
    grey = eye.overlay(frames[4][:, :, 0], measured[4])
    assert grey.shape == frames[4].shape


def test_views_of_one_moment_are_one_measurement(measured):
    one = measured[4]
    both = snakeloop.fused([one, one])
    assert (both.theta_deg, both.delta_deg) == pytest.approx((one.theta_deg, one.delta_deg))
    np.testing.assert_allclose(both.bend_covariance, one.bend_covariance / 2, rtol=1e-6)
    known = {"delta_deg": 10.0, "sigma_theta_deg": 0.1, "sigma_delta_deg": 0.2}
    poses = [snakeloop.Measurement(theta_deg=theta, **known) for theta in (30.0, 30.1, 40.0)]
    assert snakeloop.fused(poses[:2]).theta_deg == pytest.approx(30.05, abs=1e-3)
    assert snakeloop.fused(poses).status == "views_disagree"
    with pytest.raises(snakeloop.SnakeloopError, match="none were given"):
        snakeloop.fused([])


def test_a_bend_vector_is_that_of_the_angles_with_its_covariance(measured):
    for m in measured:
        delta = np.radians(m.delta_deg)
        direction = np.array([np.cos(delta), np.sin(delta)])
        np.testing.assert_allclose(m.bend_deg, m.theta_deg * direction, atol=1e-9)
        assert np.sqrt(direction @ m.bend_covariance @ direction) == pytest.approx(m.sigma_theta_deg, rel=0.02)
    straight = snakeloop.Measurement(theta_deg=0.0, delta_deg=0.0, sigma_theta_deg=0.1, sigma_delta_deg=90.0)
    assert (np.linalg.eigvalsh(straight.bend_covariance) > 0).all()
