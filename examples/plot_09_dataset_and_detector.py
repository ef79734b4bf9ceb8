"""
A data set in memory and a small slip detector
==============================================

Labelled trials of presses, slides and other movements are made in memory; a logistic regression on a few numbers of
each pair of frames learns whether slip has begun: whether more than a tenth of the contact slips. Trials with
other friction than those it has seen judge it.
"""

import matplotlib.pyplot as plt
import numpy as np

import evanesce as ev

# %%
# Small frames are enough for a detector of a handful of numbers. The data set splits by finger, rig and friction, so
# that none of them is in two splits.

samples = ev.make_dataset(
    ev.load("thesis").with_(leds__voltage_V=9.2),
    trials=14,
    seed=3,
    trial={"frames": 24, "frame_rate_hz": 12.0},
    split={"by": "finger_rig_friction", "validation": 0.0, "test": 0.4},
    friction__levels=8,
    finger__ridge_height_um={"uniform": [80.0, 160.0]},
    rig__draw={},
    randomisation__probability=0.0,
    camera__scale=0.1,
    labels__grid_samples=256,
)


# %%
# What the camera sees of slip: where the light lies, how much of it there is, and how both change between two frames.


def numbers(frame, before):
    """Return a pair's features: area, centre, its speed, mean absolute change inside and outside of the overlap."""
    now, then = frame.astype(float), before.astype(float)
    seen, was = now > 60, then > 60
    if not seen.any() or not was.any():
        return np.zeros(6)
    moved = np.argwhere(seen).mean(axis=0) - np.argwhere(was).mean(axis=0)
    change, both = np.abs(now - then) / 255, seen & was
    rim = (seen ^ was).sum() / (seen | was).sum()
    return np.array([seen.mean(), np.hypot(*moved), change[both].mean() if both.any() else 0.0, change.mean(), rim,
                     seen.sum() / was.sum() - 1])  # fmt: skip


features, slipping, test, trial, slides = [], [], [], [], []
for indices in samples.trials().values():
    before = None
    for index in indices:
        sample = samples[index]
        if before is not None:
            features.append(numbers(sample.frame, before))
            slipping.append(1 - sample.scalars["stick_ratio"])  # share of the contact
            test.append(sample.row["split"] == "test")
            trial.append(sample.row["trial"])
            slides.append(sample.row["kind"] == "slide")
        before = sample.frame
features, slipping, test, trial, slides = map(np.array, (features, slipping, test, trial, slides))
slips = slipping > 0.1

# %%
# Logistic regression by Newton's method, on standardised numbers, with a small ridge penalty.

mean, spread = features[~test].mean(axis=0), features[~test].std(axis=0) + 1e-12
design = np.column_stack([np.ones(len(features)), (features - mean) / spread])
weights = np.zeros(design.shape[1])
for _ in range(30):
    p = 1 / (1 + np.exp(-design[~test] @ weights))
    gradient = design[~test].T @ (slips[~test] - p) - 0.5 * weights
    curvature = (design[~test] * (p * (1 - p))[:, None]).T @ design[~test] + 0.5 * np.eye(len(weights))
    weights += np.linalg.solve(curvature, gradient)
probability = 1 / (1 + np.exp(-design @ weights))

# %%
# Left: the receiver operating characteristic on unseen friction. Right: the probability along the slides of the test
# split, above the share of the contact that slips.

order = np.argsort(-probability[test])
hits, alarms = np.cumsum(slips[test][order]), np.cumsum(~slips[test][order])
true_rate, false_rate = hits / hits[-1], alarms / alarms[-1]
auc = np.trapezoid(true_rate, false_rate)
print(f"{test.sum()} pairs of unseen friction, slip in {slips[test].mean():.0%}, area under the curve {auc:.2f}")
figure = plt.figure(figsize=(12, 5), layout="constrained")
left, right = figure.subfigures(1, 2, width_ratios=(1, 1.5))
axis = left.subplots()
axis.plot(np.r_[0, false_rate], np.r_[0, true_rate], color="#3d7dca", linewidth=2.5, label=f"area {auc:.2f}")
axis.plot([0, 1], [0, 1], color="0.6", linestyle="--", label="by chance")
axis.set(xlabel="false alarms [1]", ylabel="slip detected [1]", title="unseen friction", aspect="equal")
axis.legend(loc="lower right", frameon=False)
shown = np.unique(trial[test & slides])[:3]
for number, axis in zip(shown, right.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0], strict=True):
    here = trial == number
    time_s = np.arange(1, here.sum() + 1) / 12.0
    axis.fill_between(time_s, slipping[here], color="#ff8c1a", alpha=0.45, linewidth=0, label="truth: share that slips")
    axis.plot(time_s, probability[here], "o-", color="#3d7dca", markersize=4, label="detector: probability of slip")
    axis.set(ylim=(0, 1.05), xlim=(0, time_s[-1]), ylabel=f"trial {number}")
axis.set_xlabel("time [s]")
right.axes[0].set_title("slides of the test split")
right.axes[0].legend(loc="upper left", fontsize=8)
plt.show()
