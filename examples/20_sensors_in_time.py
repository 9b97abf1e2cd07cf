"""A robot and three sensors: one drifts away, one is late, one goes silent. Which of them is to be believed?

Each measures the place at times of its own, z_k = H x(t_k) + v_k, and x(t_k) = F(t_k - t_j) x(t_j) + w. The one that
drifts is found by judging the recent past under every fault of every sensor, and left out.
"""

# %% A point in the plane, and what the three say of it: (arrival, sensor, stamp, z).
import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from robust_filterpy.fusion import Fusion, Sensor, constant_velocity
from robust_filterpy.plotting import LOOKS

RATES, SIGMA, END = {"radar": 6.0, "beacon": 5.0, "camera": 4.0}, 0.8, 60.0
PLACE = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
COLOURS = {
    "healthy": "#4daf4a", "departs": "#ffd92f", "biased": "#ff7f00", "drifting": "#b2182b", "stuck": "#984ea3",
    "noisier": "#a65628", "spikes": "#f781bf", "silent": "#bbbbbb",
}  # fmt: skip


def recorded(rng):
    """Return readings in the order of arrival, and where the robot was at each stamp."""
    motion, x, before, readings, places = constant_velocity(2, q=0.3), np.array([0.0, 1.5, 0.0, 0.5]), 0.0, [], []
    events = sorted((k / f + 0.013 * i, n) for i, (n, f) in enumerate(RATES.items()) for k in range(int(END * f)))
    for t, name in events:
        F, Q, _ = motion.matrices(t - before)
        x, before = rng.multivariate_normal(F @ x, Q), t
        places.append((t, x[0], x[2]))
        z = x[[0, 2]] + SIGMA * rng.normal(size=2)
        if name == "beacon" and t > 25.0:
            z = z + 0.4 * (t - 25.0) * np.array([1.0, -0.5])
        if name != "camera" or t < 52.0:
            readings.append((t + (rng.uniform(0.0, 1.0) if name == "radar" else 0.0), name, t, z))
    return sorted(readings, key=lambda one: one[0]), np.array(places)


# %% Two fusions hear the same; one of them watches its sensors. They are asked twice a second.
def followed(readings, asked):
    """Return what the watching one knew and said, and what the other knew, at each time; and the report at the end."""
    sensors = {name: Sensor(PLACE, R=SIGMA**2) for name in RATES}
    watching, trusting = (Fusion(constant_velocity(2, q=0.3), sensors, 1.5, watch=watch) for watch in (True, False))
    knew, said, other, place = [], [], [], 0
    for now in asked:
        while place < len(readings) and readings[place][0] <= now:
            for fusion in (watching, trusting):
                fusion.observe(*readings[place][1:])
            place += 1
        knew.append(watching.estimate(now))
        other.append(trusting.estimate(now).x[[0, 2]])
        said.append({name: verdict.fault for name, verdict in watching.verdicts(now).items()})
    return knew, said, np.array(other), watching.report()


# %% The tracks, how far off they are, and a strip for each sensor.
def main(arguments=None):
    """Draw the figure and print what is said of each sensor, and what that is worth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    out = parser.parse_args(arguments).out
    readings, places = recorded(np.random.default_rng(4))
    asked = np.arange(3.0, END, 0.5)
    knew, said, other, report = followed(readings, asked)
    track = np.array([one.x[[0, 2]] for one in knew])
    where = np.column_stack([np.interp(asked, places[:, 0], places[:, i]) for i in (1, 2)])
    unwatched, watched = (np.hypot(*(one - where).T) for one in (other, track))
    figure, (above, error, below) = plt.subplots(3, 1, figsize=(8, 9), height_ratios=(3, 1.2, 1), layout="constrained")
    above.plot(*places[:, 1:].T, color="black", linewidth=4, alpha=0.25, label="where the robot was")
    lies = np.array([z for _, name, _, z in readings if name == "beacon"])
    above.plot(*lies.T, ".", markersize=3, color=COLOURS["drifting"], alpha=0.4, label="what the beacon said")
    grey = {"color": "#666666", "linestyle": "--", "linewidth": 1.2}
    for name, way, off, look in (("not watched", other, unwatched, grey), ("watched", track, watched, LOOKS["Huber"])):
        above.plot(*way.T, label=f"sensors {name}", **look)
        error.plot(asked, off, label=f"sensors {name}", **look)
    error.set(xlabel="time, s", ylabel="error, m", xlim=(0, END), ylim=(0, None), title="How far off each of them is")
    error.legend(fontsize=8, loc="upper left")
    above.set(xlabel="east, m", ylabel="north, m", title="A beacon that drifts is found and left out")
    above.legend(fontsize=8)
    for row, name in enumerate(RATES):
        below.barh(row, 0.5, left=asked, color=[COLOURS[verdict[name]] for verdict in said])
    seen = [fault for fault in COLOURS if any(verdict[name] == fault for verdict in said for name in RATES)]
    below.set(yticks=range(3), yticklabels=list(RATES), xlabel="time, s", xlim=(0, END))
    below.set_title("What is said of each sensor")
    patches = [plt.Rectangle((0, 0), 1, 1, color=COLOURS[fault]) for fault in seen]
    below.legend(patches, seen, ncols=len(seen), fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.35))
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "20_sensors_in_time.png"
    figure.savefig(path, dpi=120)
    plt.close(figure)
    print(report)
    print(f"Figure: {path}")
    without, found = (np.sqrt(np.mean(off[asked > 30.0] ** 2)) for off in (unwatched, watched))
    print(
        f"Conclusion: from 30 s on the position is off by {without:.2f} m if outliers alone are held against a sensor, "
        f"by {found:.2f} m if the one that drifts is found and left out."
    )


if __name__ == "__main__":
    main()
