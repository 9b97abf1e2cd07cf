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


# %% The track with its band, and a strip for each sensor.
def main(arguments=None):
    """Draw the figure and print what is said of each sensor, and what that is worth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("figures"))
    out = parser.parse_args(arguments).out
    readings, places = recorded(np.random.default_rng(4))
    asked = np.arange(3.0, END, 0.5)
    knew, said, other, report = followed(readings, asked)
    track = np.array([one.x[[0, 2]] for one in knew])
    figure, (above, below) = plt.subplots(2, 1, figsize=(8, 7), height_ratios=(3, 1), layout="constrained")
    above.plot(*places[:, 1:].T, color="black", linewidth=4, alpha=0.25, label="where the robot was")
    lies = np.array([z for _, name, _, z in readings if name == "beacon"])
    above.plot(*lies.T, ".", markersize=3, color=COLOURS["drifting"], alpha=0.4, label="what the beacon said")
    above.plot(*other.T, "--", color="#666666", linewidth=1, label="every sensor believed")
    above.plot(*track.T, color="#377eb8", linewidth=1.5, label="sensors watched, with two standard deviations")
    turn = np.linspace(0.0, 2.0 * np.pi, 40)
    for one in knew[::4]:
        values, vectors = np.linalg.eigh(one.P[np.ix_([0, 2], [0, 2])])
        ring = one.x[[0, 2]] + 2.0 * (vectors * np.sqrt(values) @ [np.cos(turn), np.sin(turn)]).T
        above.fill(*ring.T, color="#377eb8", alpha=0.15, linewidth=0)
    above.set(xlabel="east, m", ylabel="north, m", title="A beacon that drifts is found and left out")
    above.legend(fontsize=8)
    for row, name in enumerate(RATES):
        below.barh(row, 0.5, left=asked, color=[COLOURS[verdict[name]] for verdict in said])
    seen = [fault for fault in COLOURS if any(verdict[name] == fault for verdict in said for name in RATES)]
    below.set(yticks=range(3), yticklabels=list(RATES), xlabel="time, s", title="What is said of each sensor")
    patches = [plt.Rectangle((0, 0), 1, 1, color=COLOURS[fault]) for fault in seen]
    below.legend(patches, seen, ncols=len(seen), fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.35))
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "20_sensors_in_time.png"
    figure.savefig(path, dpi=120)
    plt.close(figure)
    where = np.column_stack([np.interp(asked, places[:, 0], places[:, i]) for i in (1, 2)])
    late = asked > 30.0
    believed, watched = (np.sqrt(((one - where)[late] ** 2).sum(axis=1).mean()) for one in (other, track))
    print(report)
    print(f"Error from 30 s on: {believed:.2f} m if every sensor is believed, {watched:.2f} m if they are watched.")
    gain = 100.0 * (1.0 - watched / believed)
    print(f"Conclusion: leaving out the sensor that lies takes {gain:.0f} % off the error of the position.")
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
