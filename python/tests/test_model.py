"""Model: arrays in, arrays out, the same numbers as the library's."""

import numpy as np
import pytest
from conftest import ROOT, columns

import snakeloop

MODEL = snakeloop.Model.default()


def test_commands_are_those_of_the_golden_table():
    golden = columns(ROOT / "tests" / "golden" / "compensation.csv")
    commands = MODEL.command(theta_deg=golden["theta_deg"], delta_deg=golden["delta_deg"])
    expected = np.stack([golden[f"qc{i}_mm"] for i in (1, 2, 3)], axis=1)
    np.testing.assert_allclose(commands, expected, rtol=0, atol=5.1e-7)


def test_degrees_and_radians_are_told_by_name_and_shapes_broadcast():
    theta_deg = np.linspace(1, 80, 6).reshape(2, 3, 1)
    delta_deg = np.array([-120.0, 0.0, 60.0, 179.0])
    commands = MODEL.command(theta_deg=theta_deg, delta_deg=delta_deg)
    assert commands.shape == (2, 3, 4, 3)
    np.testing.assert_array_equal(commands, MODEL.command(np.radians(theta_deg), np.radians(delta_deg)))
    np.testing.assert_array_equal(commands[1, 2, 3], MODEL.command(theta_deg=theta_deg[1, 2, 0], delta_deg=179))
    assert MODEL.command(theta_deg=30, delta_deg=0).shape == (3,)
    for wrong in [{}, {"theta": 1.0}, {"theta": 1.0, "theta_deg": 1.0, "delta": 0.0}]:
        with pytest.raises(snakeloop.SnakeloopError, match="give either"):
            MODEL.command(**wrong)
    with pytest.raises(snakeloop.SnakeloopError, match=r"\[3\].*\[4\]"):
        MODEL.command([1, 2, 3], [1, 2, 3, 4])


def test_forward_undoes_command_and_answers_nan_where_there_is_no_answer():
    random = np.random.default_rng(1)
    theta_deg, delta_deg = random.uniform(1, 90, (5, 7)), random.uniform(-179, 179, (5, 7))
    there = MODEL.command(theta_deg=theta_deg, delta_deg=delta_deg)
    back_theta, back_delta = MODEL.forward(there)
    np.testing.assert_allclose(back_theta, theta_deg, atol=1e-7)
    np.testing.assert_allclose(back_delta, delta_deg, atol=1e-6)
    theta, delta = MODEL.forward([[100.0, 0, 0], [np.nan, 0, 0], there[0, 0]])
    assert np.isnan([theta[:2], delta[:2]]).all() and theta[2] == back_theta[0, 0]
    with pytest.raises(snakeloop.SnakeloopError, match="3 backbones"):
        MODEL.forward([1.0, 2.0])


def test_a_model_is_written_and_read(tmp_path):
    MODEL.write(tmp_path / "model.toml")
    assert snakeloop.Model.read(tmp_path / "model.toml") == MODEL
    assert (MODEL.eta, MODEL.lambda_mm, MODEL.backbones, MODEL.effects) == (1.0, 0.0, 3, [])
    assert "length_mm = 26.0" in str(MODEL) and "naive" in repr(MODEL)


def test_the_version_is_the_library_s():
    manifest = (ROOT / "Cargo.toml").read_text()
    assert f'version = "{snakeloop.__version__}"' in manifest.split("[lib]")[0]


def test_errors_carry_file_and_line(tmp_path):
    file = tmp_path / "model.toml"
    file.write_text('[robot]\nlength_mm = 26.0\nlenght_mm = 26.0\n')
    with pytest.raises(snakeloop.SnakeloopError, match="lenght_mm") as caught:
        snakeloop.Model.read(file)
    assert (caught.value.path, caught.value.line) == (str(file), 3)
    with pytest.raises(snakeloop.SnakeloopError, match="cannot read") as caught:
        snakeloop.Lens.read(tmp_path / "nowhere.yaml")
    assert (caught.value.path, caught.value.line) == (str(tmp_path / "nowhere.yaml"), None)
    with pytest.raises(snakeloop.SnakeloopError) as caught:
        MODEL.command()
    assert caught.value.path is None


def test_a_robot_of_some_constants_has_the_papers_for_the_others():
    paper = snakeloop.Robot()
    assert paper == snakeloop.Model.default().robot and snakeloop.Model(paper) == snakeloop.Model.default()
    assert snakeloop.Robot(**paper.constants) == paper
    robot = snakeloop.Robot(length_mm=np.int64(35), backbones=4, secondary={"youngs_modulus_gpa": np.float32(60)})
    assert (robot.constants["length_mm"], robot.constants["backbones"]) == (35.0, 4) and "4 backbones" in repr(robot)
    assert robot.constants["secondary"] == paper.constants["secondary"] | {"youngs_modulus_gpa": 60.0}
    model = snakeloop.Model(robot=robot)
    assert model.robot == robot and model.eta == 1.0 and model.command(theta_deg=30, delta_deg=0).shape == (4,)
    for constants, why in [
        ({"lenght_mm": 35.0}, "lenght_mm.*`length_mm`.*`backbones`"),
        ({"body": {"colour": "red"}}, "colour.*disk_diameter_mm"),
        ({"length_mm": "long"}, "long"),
        ({"length_mm": -1.0}, "robot.length_mm = -1"),
        ({"length_mm": float("nan")}, "robot: "),
        ({"length_mm": object()}, "robot: "),
    ]:
        with pytest.raises(snakeloop.SnakeloopError, match=why):
            snakeloop.Robot(**constants)
