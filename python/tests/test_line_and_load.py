"""estimate_stem and tip_force: what is hidden in simulated readings is found, and what must not be used is refused."""

import numpy as np
import pytest

import snakeloop


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """The paper's robot with η and λ known, and 1 % of doubt about η."""
    path = tmp_path_factory.mktemp("known") / "model.toml"
    path.write_text("[estimate]\neta = 1.221\nsd_eta = 0.001\nlambda_mm = 0.1765\nsd_lambda_mm = 0.001\ncorrelation = 0.0\nsamples = 36\n")
    return snakeloop.Model.read(path)


def test_a_load_that_is_hidden_is_found_within_its_covariance(known):
    load = np.array([0.2, 0.0, -0.1])
    loaded = known.with_effects({"tip_load": dict(zip(["fx_n", "fy_n", "fz_n"], load, strict=True))})
    assert [effect["name"] for effect in loaded.effects] == ["tip_load"] and known.effects == []
    found = snakeloop.tip_force(*snakeloop.simulate(loaded)[:2], known)
    assert found.verdict.level == "good" and repr(found).endswith("N: good>")
    error = found.force_n - load
    assert found.unseen.shape == (0, 3) and error @ np.linalg.solve(found.covariance_n2, error) < 16.3   # χ²(3), 99.9 %
    assert len(found.rows["fx_n"]) == 36
    # With the load in the model nothing is left.
    rest = snakeloop.tip_force(*snakeloop.simulate(loaded)[:2], loaded).force_n
    np.testing.assert_allclose(rest, error, atol=0.02)


def test_the_angle_of_a_stem_is_found(known):
    measurements, encoders, _ = snakeloop.simulate(known)
    found = snakeloop.estimate_stem(measurements, encoders, known)
    assert abs(found.phi_deg - 82.0) < 4 * found.sd_phi_deg                     # the cone's own 2 · 41°
    assert len(found.rows["phi_deg"]) == 36 and found.rows["phi_deg"][-1] == pytest.approx(found.phi_deg, abs=1e-4)
    slow, fast = (snakeloop.estimate_stem(measurements, encoders, known, forgetting=f).sd_phi_deg for f in (0.99, 0.8))
    assert slow < fast


def test_effects_and_models_that_cannot_be_are_refused(known):
    with pytest.raises(snakeloop.SnakeloopError, match="tip_lode"):
        known.with_effects({"tip_lode": {"fx_n": 0.2}})
    measurements, encoders, _ = snakeloop.simulate(known)
    for function in [snakeloop.estimate_stem, snakeloop.tip_force]:
        with pytest.raises(snakeloop.SnakeloopError, match="η and λ"):
            function(measurements, encoders, snakeloop.Model())
