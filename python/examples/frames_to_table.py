# %% [markdown]
# From frames to a compensation table, and a picture of both.
#
# Needs `pip install ./python pillow matplotlib`. The cells run one by one in an editor that knows `# %%`, or all at once:
# `python python/examples/frames_to_table.py [EXPERIMENT] [PICTURE]`.

# %% What the experiment is.
import csv
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import snakeloop

here = Path(__file__).resolve().parents[2]
experiment = Path(sys.argv[1]) if len(sys.argv) > 1 else here / "fixtures" / "bending"
picture = Path(sys.argv[2]) if len(sys.argv) > 2 else Path("frames_to_table.png")


def load(path):
    """A picture as an array; RGB, as snakeloop expects it (OpenCV's imread gives BGR: turn it around with [..., ::-1])."""
    return np.asarray(Image.open(path))


# %% Where camera, grid and base are: from a picture of the unbent snake, then refined with frames of bent ones.
lens = snakeloop.Lens.read(experiment / "camera.yaml")
rig = snakeloop.Rig.calibrate(load(experiment / "straight.jpg"), lens, grid_pitch_mm=1.0, standoff_mm=25.0)
frames = {int(path.stem): load(path) for path in sorted((experiment / "frames").glob("*.jpg"))}
eye = snakeloop.Eye(lens, rig).refined(frames.values())

# %% Every frame: θ and δ with their standard deviations; and the estimator learns from each.
with open(experiment / "encoders.csv", newline="") as file:
    q_mm = {int(row["index"]): [float(row[f"q{i}_mm"]) for i in (1, 2, 3)] for row in csv.DictReader(file)}
estimator = snakeloop.Estimator()
measurements, etas, sds = [], [], []
for index, frame in frames.items():
    measurement = eye.measure(frame)
    step = estimator.update(measurement, q_mm[index])
    print(index, measurement, step.verdict)
    measurements.append(measurement)
    etas.append(np.nan if estimator.eta is None else estimator.eta)
    sds.append(np.nan if estimator.eta is None else np.sqrt(estimator.covariance[0, 0]))
model = estimator.model
print(repr(model))

# %% The table: what to command for every pose.
theta_deg, delta_deg = np.meshgrid(np.arange(0, 91, 5.0), np.arange(-180, 181, 15.0), indexing="ij")
command_mm = model.command(theta_deg=theta_deg, delta_deg=delta_deg)
naive_mm = snakeloop.Model.default().command(theta_deg=theta_deg, delta_deg=delta_deg)

# %% All of it in one picture.
figure, (bends, learning, table) = plt.subplots(1, 3, figsize=(15, 4.5), layout="constrained")
theta = np.array([m.theta_deg for m in measurements])
naive_theta, _ = snakeloop.Model.default().forward(list(q_mm.values()))
learned_theta, _ = model.forward(list(q_mm.values()))
order = np.argsort(theta)
bends.plot(theta[order], (naive_theta - theta)[order], "o", label="naive model")
bends.plot(theta[order], (learned_theta - theta)[order], "o", label="learned model")
bends.set(title="Bend that the encoders predict", xlabel="measured θ (°)", ylabel="predicted − measured θ (°)")
bends.legend()
learning.errorbar(range(1, len(etas) + 1), etas, yerr=2 * np.array(sds), fmt="o-", capsize=3)
learning.set(title="η as it is learned (± 2 σ)", xlabel="measurement", ylabel="η")
change_mm = (command_mm - naive_mm)[..., 0]
limit_mm = np.abs(change_mm).max()
mesh = table.pcolormesh(delta_deg, theta_deg, change_mm, shading="nearest", cmap="RdBu_r", vmin=-limit_mm, vmax=limit_mm)
figure.colorbar(mesh, ax=table, label="mm")
table.set(title="Backbone 1: learned less naive command", xlabel="δ (°)", ylabel="θ (°)")
figure.savefig(picture, dpi=80)
print(f"drawn: {picture}")
