"""Measures a snake-like surgical robot in camera frames, learns its actuation losses and compensates them.

A thin shell over the Rust library of the same name. Lengths are mm; angles are degrees where a name ends in ``_deg`` and radians
elsewhere. θ (``theta``) is the bend from straight, δ (``delta``) the azimuth that the tip leans towards.

>>> import snakeloop
>>> model = snakeloop.Model.default()
>>> model.command(theta_deg=[0, 30], delta_deg=0).shape
(2, 3)
"""

from ._snakeloop import (
    Discovery,
    Estimate,
    Estimator,
    Eye,
    Lens,
    Measurement,
    Model,
    Rig,
    Robot,
    Run,
    SnakeloopError,
    StemEstimate,
    Step,
    TipForce,
    Verdict,
    __version__,
    discover,
    estimate,
    estimate_stem,
    fused,
    run,
    simulate,
    tip_force,
)

__all__ = [
    "Discovery",
    "Estimate",
    "Estimator",
    "Eye",
    "Lens",
    "Measurement",
    "Model",
    "Rig",
    "Robot",
    "Run",
    "SnakeloopError",
    "StemEstimate",
    "Step",
    "TipForce",
    "Verdict",
    "__version__",
    "discover",
    "estimate",
    "estimate_stem",
    "fused",
    "run",
    "simulate",
    "tip_force",
]
