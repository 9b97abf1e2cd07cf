"""The kernel under learnt noise is the definition, step by step, or declines and leaves everything as it was."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.signal import lfilter
from support import random_problem, simulate, with_

from robust_filterpy import kernel
from robust_filterpy.correction import side_by_side
from robust_filterpy.correction.learning import NoiseClasses
from robust_filterpy.correction.learnt import correct
from robust_filterpy.correction.side_by_side import Scales
from robust_filterpy.kernel.series import Rows, begin_models, mixture_rule, run

pytestmark = pytest.mark.skipif(not hasattr(kernel.extension(), "filter_series"), reason="the kernel is not built")
OPTIONS = [
    (NoiseClasses(), Scales()),
    (NoiseClasses(), Scales(jump=0.0)),
    (NoiseClasses(scales=(1.0,)), Scales((1.0,), jump=0.0)),
    (NoiseClasses(scales=(1.0, 100.0), probabilities=(0.9, 0.1)), Scales((1.0, 9.0), dwell=5.0, jump=1e-4)),
    (NoiseClasses(grouping="joint"), Scales()),
    (NoiseClasses(grouping=((0, 1), (2, 3))), Scales()),
    (NoiseClasses((1.0, 64.0), ((0, 2),), probabilities=(0.9, 0.1)), Scales((1.0, 9.0), 50, 0, (0.8, 0.2))),
]


def recording(seed, dims, steps=60, diagonal=False):
    problem = random_problem(seed, *dims)
    if diagonal:
        problem = with_(problem, R=np.diag(problem.R.diagonal()))
    zs = simulate(problem, steps, seed, contamination=0.2, size=40.0)[0]
    zs[steps // 2 :] += 200.0
    zs[np.random.default_rng(seed).random(zs.shape) < 0.1] = np.nan
    zs[5] = np.nan
    return problem, zs


def alive(models):
    """The models, without what a candidate was that is none."""
    seen = models.probabilities > 0.0
    given = () if models.given is None else models.given
    return models.x[seen], models.P[seen[:, :, None] & seen[:, None]], models.belief, *given


@pytest.mark.parametrize("noise, process", OPTIONS)
@pytest.mark.parametrize(
    "seed, dims", list(enumerate([(1, 1), (2, 1), (4, 1), (4, 2), (3, 3), (5, 2), (1, 4), (2, 4)]))
)
def test_every_step_is_the_definitions(noise, process, seed, dims):
    compare(*recording(seed, dims, diagonal=seed % 2 == 0), noise, process)


def compare(problem, zs, noise, process, passed=(), M=None, states=None, rounding=5e-8):
    """Take every step by both, some with an H of its own; return the weights, and what is known at the end."""
    F, Q, R, m = problem.F, problem.Q, problem.R, zs.shape[1]
    models, memory = side_by_side.start(problem.x[:, 0], problem.P, process), noise.start(m)
    state = begin_models(models, memory)
    rows = Rows(weights=np.empty((len(zs), m)), outlying=np.empty((len(zs), m)), log_likelihood=np.zeros(1))
    total = 0.0
    for k, z in enumerate(zs):
        H = dict(passed).get(k, problem.H)
        models = side_by_side.predict(models, F, Q, process)
        found = correct(models, memory, z, H, R, noise, process, M)
        models, memory, total = found.models, found.memory, total + found.log_density
        model = F[None], Q[None], H[None], R[None], None
        assert run(mixture_rule(noise, process), state, zs, model, rows, first=k, last=k + 1, M=M)
        ours = side_by_side.Models.unpacked(*state[:3])
        pairs = [
            *zip(alive(models), alive(ours), strict=True), (memory, state.learnt), (total, rows.log_likelihood[0]),
            (found.weights, rows.weights[k]), *zip(side_by_side.merged(models, process), state[4:6], strict=True),
            (found.outlier_probabilities, rows.outlying[k]),
        ]  # fmt: skip
        for i, (theirs, mine) in enumerate(pairs):
            # P is a difference: what is rounding in it is a part of its largest number. A candidate that begins with a
            # wild reading has a P of up to 1e8 times what the next one leaves: one bit in z moves the definition's P by
            # 4e-8 of itself, and probabilities by 1e-8.
            size = np.abs(np.nan_to_num(theirs)).max(initial=0.0)
            size = size if i == 1 else min(1.0, size)
            np.testing.assert_allclose(mine, theirs, rtol=rounding, atol=rounding * size)
    if states is not None:
        states.append(models.given)
    return rows.weights, memory


@pytest.mark.parametrize("noise, process", OPTIONS)
def test_noise_that_is_correlated_with_the_states_error_is_by_both(noise, process):
    problem, zs = recording(7, (3, 3), 40)
    M = 0.05 * np.random.default_rng(7).normal(size=(3, 3))
    with_M, without = (compare(problem, zs, noise, process, M=M * part)[0] for part in (1.0, 0.0))
    assert len(noise.scales) == 1 or not np.allclose(with_M, without, equal_nan=True)


@pytest.mark.parametrize("c", [1e-7, 1e7])
@pytest.mark.parametrize("seed, dims, M", [(0, (2, 1), None), (1, (4, 2), None), (2, (3, 3), 0.01)])
def test_a_wrong_factor_is_learned_by_both(c, seed, dims, M):
    problem, zs = recording(seed, dims, 130)
    # Read in steps, which hide a factor.
    zs = 4.0 * np.round(zs / 4.0) if seed == 1 else zs
    wrong = with_(problem, P=c * problem.P, Q=c * problem.Q, R=c * problem.R)
    M = None if M is None else c * M * np.random.default_rng(7).normal(size=dims)
    states = []
    # One bit in z moves the definition's models by up to 2e-5 where c is small.
    compare(wrong, zs, NoiseClasses(), Scales(), M=M, states=states, rounding=2e-5 if c < 1.0 else 5e-8)
    assert c > 1.0 or (states[-1].factor > 1e6).all()


def test_a_stuck_sensor_says_nothing_by_both():
    problem = with_(random_problem(3, 2, 2), H=np.eye(2), R=np.eye(2), F=np.eye(2), Q=1e-3 * np.eye(2))
    zs = np.random.default_rng(3).normal(size=(220, 2))
    zs[160:190, 0], zs[170:180, 1] = 70.0, -50.0
    weights, _ = compare(problem, zs, NoiseClasses(), Scales())
    stuck = np.zeros((220, 2), dtype=bool)
    stuck[161:190, 0] = stuck[171:180, 1] = True
    np.testing.assert_array_equal(weights == 0.0, stuck)


def test_a_reading_as_far_as_the_last_jump_which_another_one_contradicts_by_both():
    problem = with_(random_problem(3, 2, 2), R=np.eye(2), F=np.eye(2), Q=1e-3 * np.eye(2))
    problem = with_(problem, H=np.array([[1.0, 0.0], [1.0, 0.2]]))
    zs = np.random.default_rng(3).normal(size=(120, 2)) + 50.0 * np.searchsorted([39, 69], np.arange(120))[:, None]
    zs[100] += [-49.0, 52.0]
    compare(problem, zs, NoiseClasses(), Scales())


@pytest.mark.parametrize("start", [(75.0, -40.0), (75.0, 0.0), (0.0, 0.0)])
def test_a_candidate_lives_on_where_its_part_becomes_one_with_another_by_both(start):
    problem = with_(
        random_problem(3, 3, 3), F=np.eye(3), H=np.eye(3), R=np.eye(3), Q=1e-2 * np.eye(3), P=np.eye(3),
        x=np.zeros((3, 1)),
    )  # fmt: skip
    both = np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    zs = np.random.default_rng(8).normal(size=(20, 3)) + [*start, 0.0]
    zs[1] = both @ zs[1]
    compare(problem, zs, NoiseClasses(), Scales(), [(1, both)])


def test_a_colour_and_sensors_that_fail_together_are_learnt_by_both():
    R = np.diag([1.0, 2.0, 0.5]) + 0.3
    problem = with_(random_problem(4, 2, 3), H=np.array([[1.0, 0.0], [1.0, 0.5], [1.0, -0.2]]), R=R)
    rng = np.random.default_rng(4)
    slow = lfilter([1.0], [1.0, -0.95], rng.normal(size=(150, 3)), axis=0)
    memory = compare(problem, slow, NoiseClasses(), Scales())[1]
    assert (memory[:, -9] > 0.45 * memory[:, -8]).all()
    alike = rng.normal(size=(150, 3)) * np.where(rng.random((150, 1)) < 0.1, 30.0, 1.0)
    assert (compare(problem, alike, NoiseClasses(), Scales())[1][:, -16] > 0.9).all()


def test_arrays_that_do_not_fit_are_refused():
    problem, zs = recording(3, (3, 2))
    noise, process = NoiseClasses(), Scales()
    state = begin_models(side_by_side.start(problem.x[:, 0], problem.P, process), noise.start(2))
    model = (problem.F[None], problem.Q[None], problem.H[None], problem.R[None], None)
    for wrong in (state._replace(learnt=noise.start(1)), state._replace(means=state.means[:-1]),
                  state._replace(P=state.P[:, ::-1])):  # fmt: skip
        with pytest.raises(ValueError, match="matching shapes"):
            run(mixture_rule(noise, process), wrong, zs, model, Rows())


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("noise, process", OPTIONS[:-1])
@pytest.mark.parametrize("couples", ["nothing", "R", "H", "F"])
def test_parts_that_nothing_couples_are_apart_by_both(couples, noise, process):
    one, other = random_problem(11, 2, 1), random_problem(12, 3, 2)
    whole = {name: block_diag(getattr(one, name), getattr(other, name)) for name in ("F", "Q", "H", "R", "P")}
    if couples == "R":
        whole["R"][0, 1] = whole["R"][1, 0] = 0.1
    elif couples != "nothing":
        whole[couples][0, 2] = 0.2
    problem = with_(random_problem(13, 5, 3), x=np.zeros((5, 1)), **whole)
    # A start that is far off, a jump of one part, gaps: each part has its own candidate.
    zs = simulate(problem, 80, 5, contamination=0.1, size=20.0)[0] + [300.0, 0.0, 0.0]
    zs[40:, 1:] -= 150.0
    zs[np.random.default_rng(6).random(zs.shape) < 0.2] = np.nan
    compare(problem, zs, noise, process)
    parts = side_by_side.start(problem.x[:, 0], problem.P, process).parts
    np.testing.assert_array_equal(parts, [0, 0, 2, 2, 2])
