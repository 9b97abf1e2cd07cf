"""check_filter: right filters keep every promise, each wrong one breaks that of its name."""

import re
import subprocess
import sys
import unittest
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import wrong_filters
from filterpy.kalman import KalmanFilter
from wrong_filters import PLAIN, RIGHT_FILTERS, WRONG_FILTERS, HardGate, NoSetter, Textbook

from robust_filterpy import RobustKalmanFilter, testing
from robust_filterpy.testing import ChecksFailed, check_filter, contamination, filter_checks, models, plants


@pytest.mark.parametrize("make, not_claimed", RIGHT_FILTERS.values(), ids=RIGHT_FILTERS)
def test_right_filters_keep_every_promise(make, not_claimed):
    results = check_filter(make, not_claimed=not_claimed)
    assert {result.status for result in results} <= {"passed", "skipped"} and len(results) > 30


@pytest.mark.parametrize("cls", WRONG_FILTERS, ids=lambda cls: cls.__name__)
def test_a_wrong_filter_is_caught_by_each_check_whose_name_fits(cls):
    checks = [check for check in filter_checks(not_claimed=cls.not_claimed) if check.name in cls.caught_by]
    assert len(checks) == len(cls.caught_by)
    for check in checks:
        with pytest.raises(AssertionError, match=f"^{check.name}: "):
            check(cls)


@pytest.mark.parametrize(("name", "check", "words"), [
    ("TransposedTransition", "prediction_moves_the_state_by_F", "prediction 1: .* from F x; it is F'$"),
    ("TransposedTransitionOfP", "prediction_moves_the_covariance_by_F", "; it is F' P F$"),
    ("QThroughF", "prediction_adds_Q_once", "where F is not I .*; it is F Q F'$"),
    ("SignOfGain", "small_innovations_are_believed", "after 0 samples the step is -1 times the Kalman gain's"),
    ("PNotUpdated", "measurement_makes_the_state_more_certain", "P did not shrink in any direction"),
    ("ShownInnovationOfTheOtherSign", "innovation_and_its_covariance_are_shown", "; it has the other sign$"),
    ("LikelihoodWithoutConstant", "likelihood_is_the_gaussian_density_of_the_innovation",
     r"-m log\(2 pi\) / 2 is missing$"),
    ("PseudoInverse", "units_change_nothing", "in other units, update .* of its deviation: .* a unit of its own"),
    ("OneSided", "influence_of_one_measurement_is_bounded", r"-1e\+02 standard deviations of sensor 0.*at most 10"),
    ("CutAndCertain", "a_true_jump_is_followed", "100 samples after a jump.*P stays as small as before"),
])  # fmt: skip
def test_a_well_known_slip_is_named_with_the_call_and_the_size(name, check, words):
    cls = getattr(wrong_filters, name)
    (one,) = [each for each in filter_checks(not_claimed=cls.not_claimed) if each.name == check]
    with pytest.raises(AssertionError, match=f"(?s){words}"):
        one(cls)


def test_every_check_catches_something_wrong():
    """A check that nothing in the library fails may as well not be there."""
    names = {name for cls in WRONG_FILTERS for name in cls.caught_by}
    every = {check.name for left_out in ((), ("robust",)) for check in filter_checks(not_claimed=left_out)}
    assert names <= every
    assert len(every - names) <= 4, every - names


def test_the_error_names_every_check_that_failed_and_the_claim_without_which_it_would_not_be_one():
    with pytest.raises(ChecksFailed) as error:
        check_filter(KalmanFilter)
    message, failed = str(error.value), [result for result in error.value.results if result.status == "failed"]
    assert f"{len(failed)} of {len(error.value.results)} checks failed" in message
    assert {"nan_is_a_sensor_that_is_not_there", "influence_of_one_measurement_is_bounded"} <= {r.name for r in failed}
    assert all(result.message in message for result in failed)
    (bounded,) = (line for line in message.splitlines() if line.startswith("influence_of_one_measurement_is_bounded: "))
    assert bounded.endswith(" [robust]") and "not_claimed=(..)" in message.splitlines()[-1]


def test_what_several_checks_have_in_common_is_said_once():
    class NoInverse(Textbook):
        def gain(self, P, S):
            raise ZeroDivisionError("no gain")

    with pytest.raises(ChecksFailed) as error:
        check_filter(NoInverse, not_claimed=PLAIN)
    message = str(error.value)
    assert re.search(r"ZeroDivisionError: no gain \(\d+ checks: .*counts_at_once", message)
    assert message.count("ZeroDivisionError: no gain") == 1
    assert all(f"{r.name}" in message for r in error.value.results if r.status == "failed")


def test_the_words_for_a_jump_that_is_lost_tell_that_P_has_grown():
    class GivesUp(Textbook):
        """Gates by R and its prior, and lets P grow."""

        def update(self, z):
            if z is not None and np.abs(np.ravel(z) - np.ravel(self.H @ self.x)).max() < 8.0:
                super().update(z)

    (jump,) = [check for check in filter_checks() if check.name == "a_true_jump_is_followed"]
    with pytest.raises(AssertionError, match="P has grown"):
        jump(GivesUp)


def test_what_is_not_claimed_is_not_tested():
    every, plain = filter_checks(), filter_checks(not_claimed=("robust", "nan"))
    assert {c.name for c in every if "robust" in c.needs} and not [c for c in plain if c.needs & {"robust", "nan"}]
    assert {c.name for c in plain if "exact" in c.needs} and not [c for c in every if "exact" in c.needs]


def test_an_expected_failure_is_skipped_with_its_reason_and_warns_when_it_passes():
    name, other = "a_true_jump_is_followed", "what_is_cut_off_makes_nothing_certain"
    expected = {name: "gates for good", other: "P shrinks all the same"}
    results = check_filter(HardGate, not_claimed=HardGate.not_claimed, expected_failures=expected)
    (result,) = [result for result in results if result.name == name]
    assert result.status == "skipped" and result.message.startswith("fails as expected, gates for good: 100 samples")
    checks = filter_checks(not_claimed=PLAIN, expected_failures={"state_keeps_its_shape": "why"})
    (check,) = [check for check in checks if check.name == "state_keeps_its_shape"]
    with pytest.warns(UserWarning, match="state_keeps_its_shape: expected to fail .* but it passes"):
        check(Textbook)


def test_checks_are_parameters_for_pytest():
    for check in filter_checks():
        assert check.__name__ == check.name
        assert check.theorem.endswith(".") and len(check.theorem) > 20
    assert [check.name for check in filter_checks(seed=3)] == [check.name for check in filter_checks()]


def test_the_seed_decides_everything():
    """A filter that fails by chance fails again with the same seed, and another time with another one."""

    def outcome(seed):
        try:
            check(partial(RobustKalmanFilter, grouping="joint"), seed=seed)
        except AssertionError as error:
            return str(error)
        return ""

    check = next(c for c in filter_checks(false_alarm=0.9) if c.name == "innovations_are_white")
    found = [outcome(seed) for seed in range(4)]
    assert found == [outcome(seed) for seed in range(4)]


def test_a_check_without_meaning_is_skipped():
    check = next(c for c in filter_checks() if c.name == "nonlinear_sensor_is_linearised_at_the_prediction")
    with pytest.raises(unittest.SkipTest, match="HJacobian"):
        check(KalmanFilter)


def test_pytest_is_not_needed():
    code = (
        "import sys; sys.modules['pytest'] = None\n"
        "from filterpy.kalman import KalmanFilter; from robust_filterpy import testing\n"
        "testing.check_filter(KalmanFilter, not_claimed=('robust', 'nan', 'validates')); print('kept')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "kept\n", done.stderr


@pytest.mark.parametrize(("call", "error", "match"), [
    (lambda: check_filter(lambda n, m: None), TypeError, r"make: expected a filter with x, P, .* got None"),
    (lambda: check_filter(lambda n, m: KalmanFilter), TypeError, "make: expected a filter with"),
    (lambda: check_filter(lambda n, m: KalmanFilter(2, 1)), ValueError, "make: expected dim_x=4.* got dim_x=2"),
    (lambda: check_filter(NoSetter), TypeError, r"^make: expected a filter whose P can be set, NoSetter: "),
    (lambda: check_filter(KalmanFilter(4, 2)), TypeError, "make: expected a class or a function"),
    (lambda: check_filter(KalmanFilter, not_claimed="robust"), TypeError, r"use \('robust',\)"),
    (lambda: check_filter(KalmanFilter, not_claimed=["fast"]), ValueError, "not_claimed: expected one of"),
    (lambda: check_filter(KalmanFilter, expected_failures={"x": ""}), ValueError, "expected_failures: expected one"),
    (lambda: filter_checks(false_alarm=1.0), ValueError, "false_alarm"),
    (lambda: filter_checks(seed=-1), ValueError, "seed"),
])  # fmt: skip
def test_bad_input_is_named(call, error, match):
    with pytest.raises(error, match=match):
        call()


def test_the_page_of_the_site_is_what_the_code_says_and_lists_everything(monkeypatch):
    docs = Path(__file__).parents[2] / "docs"
    monkeypatch.syspath_prepend(str(docs))
    text = pytest.importorskip("testing_page").page()
    assert (docs / "testing.md").read_text() == text, "python docs/testing_page.py > docs/testing.md"
    names = [check.name for check in filter_checks(not_claimed=("robust",))]
    names += [*models.MODELS, *plants.PLANTS, *contamination.CONTAMINATIONS]
    names += [f"`{name}`" for name in testing.__all__ if name.startswith("assert_")]
    assert not [name for name in names if name not in text]
