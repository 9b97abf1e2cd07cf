"""How often the recent past is judged anew: that costs thousands of steps, and nothing sound asks for it."""

import numpy as np
import pytest
from fusion.worlds import line
from scipy.stats import norm

from robust_filterpy.fusion import Fusion, Sensor, _faults, _watch, constant_velocity
from robust_filterpy.influence import Linear
from robust_filterpy.kernel import available


def ended(shares):
    """Return what comes after all shares."""
    while True:
        try:
            next(shares)
        except StopIteration as end:
            return end.value


@pytest.mark.parametrize("off, fewest, most", [(0.0, 0, 1), (1.5, 1, 20)])
def test_sound_sensors_with_outliers_bring_no_looks_and_a_bias_few(monkeypatch, off, fewest, most):
    looks, judged = [], _faults.judged

    def counted(*given):
        """Judge, and once more with all hypotheses until the end."""
        with monkeypatch.context() as whole:
            whole.setattr(_faults, "_EVERY", 10**6)
            expected = {one[:2]: one for one in ended(judged(*given))}
        looks.append((yield from judged(*given)))
        for one in looks[-1]:
            assert one.probability == pytest.approx(expected[one[:2]].probability, abs=1e-4)
        assert looks[-1][0] == pytest.approx(expected[looks[-1][0][:2]], rel=1e-3)
        return looks[-1]

    monkeypatch.setattr(_faults, "judged", counted)
    rng, fusion = np.random.default_rng(8), line("abc", 2.0, 0.02, 0.09, watch=True)
    for k in range(450):
        z = 0.05 * k + 0.3 * rng.normal() + 10.0 * (rng.random() < 0.1) + off * (k > 350 and k % 3 == 1)
        fusion.observe("abc"[k % 3], 0.1 * k, z)
        fusion.estimate()
    assert fewest <= len(looks) <= most
    assert (fusion.verdicts()["b"].fault == "biased") == bool(off)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("wild", [1e4, 1e12, 1e160])
def test_wild_readings_hide_no_bias_to_come(wild):
    """Nor do they tell that the noise is larger: whatever it is, they are outliers."""
    rng, fusion = np.random.default_rng(0), line("abc", watch=True)
    for k in range(300):
        # While the noise is learned, before the fault, and where a look back takes notice.
        z = wild if k in (40, 150, 155, 230) else 0.02 * k + rng.normal() + 6.0 * (k > 220)
        for name, value in (("a", z), ("b", 0.02 * k + rng.normal()), ("c", 0.02 * k + rng.normal())):
            fusion.observe(name, 0.1 * k, value)
        assert k > 220 or fusion.verdicts()["a"].fault in ("healthy", "departs")
    verdict = fusion.verdicts()["a"]
    assert verdict.fault == "biased" and verdict.since == pytest.approx(22.1, abs=1.0)
    assert verdict.size == pytest.approx(6.0, abs=1.0) and abs(fusion.estimate().x[0] - 6.0) < 1.0


def test_the_sums_of_a_reading_are_the_odds_of_grown_noise_and_of_more_outliers():
    scales, shares, spread, R, y = [1.0, 100.0], [0.9, 0.1], 0.5, 2.0, 4.0
    row = [1.5, 100.0, 1.0, 0.0, 0.0, 0.0, 9.0, 0.0, *shares, 0.2, 0.0, 0.1]
    after = _watch._after(row, 3.0, y, spread, 1.5 * R, scales, [], True, 1.0)

    def densities(factor):
        return norm.pdf(y, scale=np.sqrt(spread + factor * 1.5 * R * np.array(scales)))

    ever = shares @ densities(1.0)
    others = [shares @ densities(4.0), shares @ densities(25.0), 0.75 * ever + 0.25 * densities(1.0)[1]]
    expected = np.maximum([0.2, 0.0, 0.1] + np.log(np.array(others) / ever), 0.0)
    np.testing.assert_allclose(after[-3:], expected, rtol=1e-12)
    assert after[_watch._NOISE] == pytest.approx(max(expected)) and max(expected) > 0.5 and after[1] == 101.0
    # Before the noise is learned nothing is summed; what repeats itself for long is as odd as that is rare.
    young = _watch._after([*row[:1], 59.0, *row[2:]], 3.0, y, spread, 1.5 * R, scales, [], True, 0.0)
    assert young[-3:] == row[-3:]
    same = _watch._after([*row[:4], 4.0, 0.1, 3.0, *row[7:]], 3.0, 0.1, spread, 1.5 * R, scales, [], True, 1.0)
    assert same[_watch._NOISE] == pytest.approx(-5.0 * np.log(0.1)) and same[4:6] == [5.0, 0.1]


def log_density(zs, rows, motion, gone):
    """Of readings, one a second, of which a part is taken away: a Kalman filter as anybody writes it."""
    (F, Q, _), x, P, total = motion.matrices(1.0), np.zeros(2), 100.0 * np.eye(2), 0.0
    for k, (z, h) in enumerate(zip(zs - gone, rows, strict=True)):
        x, P = (F @ x, F @ P @ F.T + Q) if k else (x, P)
        S = h @ P @ h + 1.0
        y, K = z - h @ x, P @ h / S
        x, P, total = x + K * y, P - np.outer(K, h @ P), total - 0.5 * (y * y / S + np.log(S))
    return total


def test_score_and_information_are_those_of_the_likelihood_of_a_fault_since_each_onset():
    rng, motion = np.random.default_rng(2), constant_velocity(1, 0.1)
    sensors = {"a": Sensor([1.0, 0.0], R=1.0), "b": Sensor([1.0, 0.3], R=1.0)}
    fusion = Fusion(motion, sensors, 500.0, P0=100.0 * np.eye(2), watch=True, influence=Linear())
    count = 86
    zs, rows, own = rng.normal(size=2 * count), np.tile([[1.0, 0.0], [1.0, 0.3]], (count, 1)), np.arange(2 * count) % 2
    for k, z in enumerate(zs):
        fusion.observe("ab"[k % 2], float(k), z)
    watch = fusion._until()[0].watch
    assert (_watch.worths(watch) == 1.0).all()
    score, information = watch.evidence.reshape(2, 2, 2, -1)
    # All begin at the reading 60, and then anew after 8, 16, .. readings, halfway between those that begin less often.
    begun = [max([60, *range(4 * 2**j, count + 1, 8 * 2**j)]) for j in range(6)]
    for c in range(2):
        for j, reading in enumerate(begun):
            at = 2 * (reading - 1) + c
            for kind in range(2):
                since = (np.arange(2 * count) - at) * (own == c)
                signal = np.where(since > 0, since if kind else 1.0, 0.0)
                less, none, more = (log_density(zs, rows, motion, b * signal) for b in (-0.5, 0.0, 0.5))
                assert score[c, kind, j] == pytest.approx(more - less, rel=1e-6, abs=1e-8)
                assert information[c, kind, j] == pytest.approx(4.0 * (2.0 * none - more - less), rel=1e-5, abs=1e-6)
            assert watch.age[c, 1, j] == 2 * count - 1 - at


def test_readings_that_are_one_to_rounding_say_nothing_of_what_lasts():
    watch, H = _watch.fresh(2, 2, 2, np.ones(1)), np.tile([1.0, 0.0], (2, 1))
    watch, statistics = watch._replace(age=np.ones(watch.age.shape)), np.ones(watch.statistics.shape)
    after = _watch._lasting(
        watch, np.eye(2), 0.0, statistics, np.arange(2), np.ones(2), H, H.T.copy(), np.ones((2, 2)), [1.0, 1.0],
        np.ones(2),
    )  # fmt: skip
    assert (after["evidence"] == 0.0).all() and np.isfinite(after["score"]).all()


@pytest.mark.skipif(not available(), reason="the kernel is not built")
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_the_kernel_takes_hypotheses_through_readings_as_the_definition(monkeypatch, n):
    rng, N, K, m, C = np.random.default_rng(n), 40, 9, 3, 3
    F, H, z = (rng.normal(size=shape) for shape in ((K, n, n), (K, m, n), (K, m)))
    z[rng.random(z.shape) < 0.2] = np.nan
    z[:2, 0] += 1e3
    shares, root = rng.dirichlet(np.ones(C), m), rng.normal(size=(n, n))
    Q, drift, scales = np.tile(root @ root.T, (K, 1, 1)), rng.normal(size=(K, n)), np.array([1.0, 30.0, 1e3])
    readings = (F, Q, drift, np.cumsum(rng.random(K)), z, H, rng.random(m) + 0.1, scales, shares, rng.random(m))
    # Of each sensor, and of none, from an onset before, within or after what is taken.
    component, onset = rng.integers(-1, m, N), rng.integers(0, K, N)
    flags, sizes = (rng.random((3, N)) < 0.5).astype(float), rng.random((3, N)) * 5.0
    flags[0, component < 0] = 1.0
    numbers = np.column_stack([component, onset, sizes[0], *flags, *sizes[1:], rng.dirichlet(np.ones(C), N)])
    got = []
    for by_kernel in (True, False):
        if not by_kernel:
            monkeypatch.setattr(_faults, "extension", lambda: None)
        x, P, sums = np.ones((N, n + 1)), np.tile(np.eye(n + 1), (N, 1, 1)), np.zeros(N)
        _faults._advance(numbers, (x, P, sums), readings, (1, 7))
        got.append((x, P, sums))
    for one, other in zip(*got, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-11 * np.abs(other).max())
    assert np.ptp(got[0][2]) > 1.0


def reading(n, counts, begins, seed=0):
    """What is known of lasting faults of three components, and a reading of two of them."""
    rng, M, o = np.random.default_rng(seed), 3, len(_watch._WIDTHS)
    H, root, m = rng.normal(size=(2, n)), rng.normal(size=(n, n)), 2
    P = root @ root.T
    moving = rng.normal(size=(n, M * 2 * o)), rng.random((2, M * 2 * o)), np.ones((M, 2, o))
    moving[2][:, 1] = rng.random((M, o)) * 9.0
    S, y, here = H @ P @ H.T + np.diag(rng.random(m) + 0.1), rng.normal(size=m), np.array([0, 2])
    F, sizes = rng.normal(size=(n, n)), rng.random(M) + 1.0
    return moving, (F, H, P @ H.T, S, y, np.sqrt(counts), here, np.array(begins), sizes, _watch._WIDTHS)


@pytest.mark.skipif(not available(), reason="the kernel is not built")
@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize(
    "counts, begins", [((1.0, 1.0), (-1.0, 2.0)), ((0.3, 1.0), (-2.0, -1.0)), ((0.0, 0.5), (-1.0, 0.0))]
)
def test_the_kernel_weighs_lasting_faults_as_the_definition(n, counts, begins):
    kernel, (moving, given), (other, _) = _watch.extension(), reading(n, counts, begins), reading(n, counts, begins)
    best = np.full(3, -np.inf)
    assert kernel.weigh_lasting((*moving, best), given, 0.7)
    np.testing.assert_allclose(best, _watch._weighed(other, given, 0.7), rtol=1e-11)
    for one, definition in zip(moving, other, strict=True):
        np.testing.assert_allclose(one, definition, rtol=1e-11, atol=1e-11)
    # Readings that are one to rounding are the definition's, and others' arrays are refused.
    before = [part.copy() for part in moving]
    assert not kernel.weigh_lasting((*moving, best), (*given[:3], np.ones((2, 2)), *given[4:]), 0.7)
    assert all(np.array_equal(one, part) for one, part in zip(moving, before, strict=True))
    for wrong in ((*given[:6], np.array([0, 3]), *given[7:]), (*given[:9], np.ones(2))):
        with pytest.raises(ValueError, match="matching shapes"):
            kernel.weigh_lasting((*moving, best), wrong, 0.7)


def test_arrays_of_other_shapes_are_refused():
    extension = _faults.extension()
    if extension is None:
        pytest.skip("the kernel is not built")
    readings = [np.ones(s) for s in ((1, 1, 1), (1, 1, 1), (1, 1), 1, (1, 1), (1, 1, 1), 1, 1, (1, 1), 1)]
    numbers, x, P, sums = np.ones((1, 9)), np.zeros((1, 2)), np.zeros((1, 2, 2)), np.zeros(1)
    numbers[0, :2] = 0.0
    extension.advance_hypotheses((numbers, x, P, sums), tuple(readings), 0, 1)
    odd = np.ones((2, 2, 2, 2))
    calls = [(numbers, [*readings[:bad], odd, *readings[bad + 1 :]], 1) for bad in range(10)]
    calls += [
        (np.where(np.arange(9) == column, value, numbers), readings, 1)
        for column, value in ((0, 1.0), (0, np.nan), (1, 1.0), (1, -1.0))
    ]
    for wrong, given, last in [*calls, (numbers, readings, 2)]:
        with pytest.raises(ValueError, match="matching shapes"):
            extension.advance_hypotheses((wrong, x, P, sums), tuple(given), 0, last)


def test_a_look_that_is_under_way_when_a_recording_ends_says_what_it_would_have_said():
    rng = np.random.default_rng(1)
    p, sensors = np.cumsum(0.1 * rng.normal(size=300)), {name: Sensor([1.0, 0.0], R=1.0) for name in "abc"}
    z = p[:, None] + rng.normal(size=(300, 3)) + 4.0 * (np.arange(300) >= 200)[:, None] * [0.0, 1.0, 0.0]
    fusion = Fusion(constant_velocity(1, 0.5), sensors, 1.0, P0=10.0 * np.eye(2), watch=True)
    for k, row in enumerate(z):
        for name, value in zip("abc", row.tolist(), strict=True):
            fusion.observe(name, 0.1 * k, value)
    fusion.estimate()
    asked = [entry.moment.watch.asked for entry in fusion._timeline.entries]
    begins = next(k for k, at in enumerate(asked) if k >= 200 and at is not None)
    ends = next(k for k in range(begins, 300) if asked[k] is None)
    assert ends > begins + 1
    said = fusion.verdicts(0.1 * ends)["b"]
    table = {"time": np.repeat(0.1 * np.arange(300), 3), "sensor": np.tile(list("abc"), 300), "value": z.ravel()}
    for last in (begins, begins + 1):
        recording = fusion.run({name: column[: 3 * last + 3] for name, column in table.items()})
        stamp, name, verdict = recording.verdicts[-1]
        assert (stamp, name) == (recording.times[-1], "b") and verdict[:2] == said[:2] != ("healthy", None)
