"""simulate and discover: what was hidden is found, from every kind of table."""

import csv

import numpy as np
import pandas
import pytest

import snakeloop

HIDDEN = {"load_directed_backlash": {"play_mm": 0.08}}


@pytest.fixture(scope="module")
def data():
    return snakeloop.simulate(effects=HIDDEN)


def write(path, table):
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(table)
        writer.writerows(zip(*table.values(), strict=True))
    return path


def test_what_was_hidden_is_named_with_its_size(data):
    found = snakeloop.discover(*data[:2])
    assert found.verdict == "named"
    [effect] = found.effects
    play = effect["parameters"]["play_mm"]
    assert effect["name"] == "load_directed_backlash" and abs(play["value"] - 0.08) < 4 * play["sd"]
    assert found.gap["after_mm"] < 0.5 * found.gap["before_mm"]
    assert found.model.effects[0]["parameters"]["play_mm"]["value"] == play["value"]
    assert str(found).startswith("named: ") and "load_directed_backlash" in repr(found)
    assert found.as_dict()["gap"] == found.gap
    html = found._repr_html_()
    assert html.startswith("<iframe srcdoc=") and "svg" in html and html.count('"') == 4


def test_files_frames_and_dicts_say_the_same(data, tmp_path):
    measurements, encoders, _ = data
    files = write(tmp_path / "measurements.csv", measurements), write(tmp_path / "encoders.csv", encoders)
    tables = [pandas.DataFrame(measurements), pandas.DataFrame(encoders)]
    expected = snakeloop.discover(measurements, encoders).as_dict()
    for found in [snakeloop.discover(*files), snakeloop.discover(*tables)]:
        assert found.as_dict() == expected


@pytest.mark.parametrize("unit", ["ns", "us", "ms"])
def test_times_may_be_dates_and_spans(data, unit):
    measurements, encoders, _ = data
    expected = snakeloop.discover(measurements, encoders)
    counts = {"ns": 1e9, "us": 1e6, "ms": 1e3}[unit]

    def timed(table, kind):
        return table | {"time_s": np.round(counts * table["time_s"]).astype("int64").astype(f"{kind}64[{unit}]")}

    for kind in ["datetime", "timedelta"]:
        found = snakeloop.discover(timed(measurements, kind), timed(encoders, kind))
        assert [effect["name"] for effect in found.effects] == [effect["name"] for effect in expected.effects]


def test_times_in_another_unit_have_no_physics_named(data):
    measurements, encoders, _ = data
    for per_second in [1e3, 1e6, 1e9]:
        tables = [table | {"time_s": per_second * table["time_s"]} for table in (measurements, encoders)]
        found = snakeloop.discover(*tables)
        assert (found.verdict, found.effects) == ("unexplained", [])
        assert found.as_dict()["reasons"][0]["code"] == "time_unit"


def test_a_log_that_is_wired_wrongly_has_no_physics_named(data):
    measurements, encoders, _ = snakeloop.simulate()
    swapped = encoders | {"q2_mm": encoders["q3_mm"], "q3_mm": encoders["q2_mm"]}
    found = snakeloop.discover(measurements, swapped)
    assert (found.verdict, found.effects) == ("unexplained", [])
    assert found.as_dict()["reasons"][0]["suggestion"]["columns"] == [1, 3, 2]


def test_tables_that_cannot_be_used_say_why(data, tmp_path):
    measurements, encoders, _ = data
    without = {name: column for name, column in encoders.items() if name != "q3_mm"}
    twice = measurements | {"index": np.zeros(len(measurements["index"]))}
    short = measurements | {"theta_deg": measurements["theta_deg"][:5]}
    for arguments, why in [
        ((measurements, without), "encoders: no column q3_mm"),
        ((twice, encoders), "index 0 is there twice"),
        ((short, encoders), "theta_deg has 5 rows, index has 36"),
        ((measurements | {"index": measurements["index"] + 0.5}, encoders), "index is 0.5"),
    ]:
        with pytest.raises(snakeloop.SnakeloopError, match=why):
            snakeloop.discover(*arguments)
    bad = write(tmp_path / "encoders.csv", encoders | {"q1_mm": ["?", *encoders["q1_mm"][1:]]})
    with pytest.warns(UserWarning, match="encoders.csv:2: q1_mm"):
        snakeloop.discover(measurements, bad)


def test_the_truth_is_what_was_asked_for_and_seeds_repeat():
    poses = {"index": [0, 1, 2], "time_s": [0.0, 1.0, 2.0], "theta_deg": [10, 20, 30], "delta_deg": [0, 90, -90]}
    measurements, encoders, truth = snakeloop.simulate(trajectory=poses, seed=3)
    np.testing.assert_allclose(truth["theta_deg"], poses["theta_deg"])
    again = snakeloop.simulate(trajectory=poses, seed=3)
    np.testing.assert_array_equal(encoders["q1_mm"], again[1]["q1_mm"])
    quiet = snakeloop.simulate(trajectory=poses, sd_encoder_mm=0.0)[1]
    expected = snakeloop.Model.default().command(theta_deg=poses["theta_deg"], delta_deg=poses["delta_deg"])
    np.testing.assert_allclose(np.stack([quiet[f"q{i}_mm"] for i in (1, 2, 3)], axis=1), expected, atol=1e-12)
    assert measurements["status"] == ["ok"] * 3
    with pytest.raises(snakeloop.SnakeloopError, match="sd_encoder_mm is -1"):
        snakeloop.simulate(sd_encoder_mm=-1.0)
    with pytest.raises(snakeloop.SnakeloopError, match="not known"):
        snakeloop.simulate(effects={"poltergeist": {}})


def test_few_samples_are_searched_as_all_others():
    # Every other of 36 poses of a robot with nothing hidden, whose η is 1.
    measurements, encoders, _ = [{name: column[::2] for name, column in table.items()} for table in snakeloop.simulate()]
    found = snakeloop.discover(measurements, encoders)
    assert (found.verdict, found.effects) == ("none", [])
    assert abs(found.model.eta - 1.0) < 0.02 and "What the model lacks: nothing" in found._repr_html_()


def test_a_coupling_asks_for_the_neighbours_readings_and_says_where_it_takes_them_at_rest(data, tmp_path):
    measurements, encoders, _ = data
    text = str(snakeloop.Model.default()) + (
        '\n[[effect]]\nname = "section_coupling"\n'
        'parameters.n1_along = { value = 0.3, sd = 0.01, unit = "1" }\nparameters.n1_across = { value = 0.0, sd = 0.01, unit = "1" }\n'
    )
    (tmp_path / "coupled.toml").write_text(text)
    model = snakeloop.Model.read(tmp_path / "coupled.toml")
    log = write(tmp_path / "encoders.csv", encoders)
    for without in [encoders, pandas.DataFrame(encoders), log]:
        with pytest.raises(snakeloop.SnakeloopError, match="neighbouring section 1.*n1_q1_mm"):
            snakeloop.discover(measurements, without, model)
    beside = encoders | {f"n1_q{i}_mm": np.zeros(len(encoders["index"])) for i in (1, 2, 3)}
    assert snakeloop.discover(measurements, beside, model).verdict == "named"
    for answer in [
        lambda: model.command(theta_deg=30, delta_deg=0),
        lambda: model.forward([0.1, 0.1, 0.1]),
        lambda: snakeloop.Estimator(model),
    ]:
        with pytest.warns(UserWarning, match="neighbouring sections are taken to be at rest"):
            answer()
