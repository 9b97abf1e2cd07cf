"""Every tuned number stands in the table of its room, with its value. Run as a program it counts those of the rules."""

import ast
import math
import re
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import robust_filterpy
from robust_filterpy.correction import factor, learning, learnt, repeats, side_by_side, spread
from robust_filterpy.influence.information import minimax_threshold

#: The table of each room: page and heading.
TABLES = {
    "correction": ("equations.md", "All numbers of the rules"),
    "fusion": ("tuned_numbers.md", "Fusion"),
    "identification.estimation": ("tuned_numbers.md", "Estimation of models"),
}
#: What mathematics says and nobody chooses: quantiles, logarithms of 2 pi, the largest float, twice another number.
MATHEMATICS = re.compile(r"(QUA\w+|LOG_ROOT|LOG_2PI|LOG_SQRT_2PI|DECIDED)$")
MOST = 50
ROW = re.compile(r"^\| `(\S+)` \| ([^|]+) \|", re.M)


def stated(room="correction"):
    """Return the numbers of the page, of the rules and of the arithmetic, by module and name."""
    page, heading = TABLES[room]
    text = Path(__file__).parents[2].joinpath("docs", page).read_text(encoding="utf-8")
    section = text.partition(f"## {heading}\n")[2].partition("\n## ")[0]
    rules, _, arithmetic = section.partition("These guard the arithmetic")
    return tuple(
        {name: tuple(_number(text) for text in values.split(",")) for name, values in ROW.findall(part)}
        for part in (rules, arithmetic)
    )


def _number(text):
    """Return the value of .5, log 30 or 8 / 6."""
    value, _, over = text.strip().removeprefix("log ").partition("/")
    return math.log(float(value)) if "log" in text else float(value) / float(over or 1)


def _flat(value):
    """Return the numbers of a number or of a tuple, None if it holds anything else."""
    if not isinstance(value, tuple):
        return (value,) if isinstance(value, (int, float)) and not isinstance(value, bool) else None
    parts = [_flat(part) for part in value]
    return None if not parts or None in parts else sum(parts, ())


def in_modules(room="correction"):
    """Return the numbers at the head of each module; a whole number is one where the page has it, else a place."""
    page, found = stated(room)[0] | stated(room)[1], {}
    for path in sorted(Path(robust_filterpy.__file__).parent.joinpath(*room.split(".")).glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        imported = {one.name for node in tree.body if isinstance(node, ast.ImportFrom) for one in node.names}
        for name, value in vars(import_module(f"robust_filterpy.{room}.{path.stem}".removesuffix(".__init__"))).items():
            key = f"{path.stem}.{name}"
            # What is computed from other numbers is an array, and need not be there.
            numbers = _flat(tuple(value.tolist()) if isinstance(value, np.ndarray) and key in page else value)
            if not numbers or not name.isupper() or MATHEMATICS.search(name) or max(numbers) > 1e308:
                continue
            if name not in imported and (key in page or any(isinstance(part, float) for part in numbers)):
                found[key] = tuple(float(part) for part in numbers)
    return found


@pytest.mark.parametrize("room", TABLES)
def test_the_page_has_every_number_with_its_value(room):
    rules, arithmetic = stated(room)
    assert not rules.keys() & arithmetic.keys()
    found = in_modules(room)
    assert len(found) > 40 and (rules | arithmetic).keys() == found.keys(), (rules | arithmetic).keys() ^ found.keys()
    wrong = {name: value for name, value in found.items() if (rules | arithmetic)[name] != pytest.approx(value, 1e-12)}
    assert not wrong, wrong


#: Numbers of C by their header, with the modules that have them, and what has another name there or is its square.
HEADERS = {"SPREAD": [spread], "LEARNT": [learnt, learning, factor, side_by_side], "REPEATS": [repeats]}
OTHERWISE = {
    **dict(zip(("SPREAD_CURVE", "SPREAD_SLOPE", "SPREAD_BASE"), np.abs(spread.MINIMAX), strict=True)),
    "SPREAD_RUN": spread.RUN_LENGTH, "SPREAD_FADING": 1.0 / spread.MEMORY, "SPREAD_GROWTH": spread.LARGEST_GROWTH,
    "LEARNT_LESS": learning._LESS_SCALE, "LEARNT_COLOUR": learning._MOST_COLOUR, "LEARNT_ASKS": spread.FAR**2,
    "LEARNT_FARTHEST": side_by_side._FARTHEST**2, "LEARNT_FAR": side_by_side._FAR**2,
    "LEARNT_EVIDENCE": math.exp(learning.LOG_EVIDENCE), "LEARNT_TELLS": math.exp(learnt._LOG_TELLS),
}  # fmt: skip


def test_the_kernel_has_the_same_numbers():
    count = 0
    for header, modules in HEADERS.items():
        text = Path(robust_filterpy.__file__).with_name("kernel").joinpath(f"{header.lower()}.h").read_text()
        for name, value in re.findall(rf"^#define {header}_(\w+) ((?:REAL\([\d.e+-]+\)|\d+)(?: / \d+)?)", text, re.M):
            number = math.prod(float(part) ** (1 - 2 * k) for k, part in enumerate(re.findall(r"\d[\d.e+-]*", value)))
            here = [vars(module)[one] for module in modules for one in (name, f"_{name}") if one in vars(module)]
            # A whole number may be a place.
            expected = [OTHERWISE.get(f"{header}_{name}"), *sorted(here, key=lambda one: isinstance(one, int)), None]
            assert number == pytest.approx(next(filter(None, expected), math.nan), rel=1e-12), f"{header}_{name}"
            count += 1
    assert count > 40


@pytest.mark.parametrize("share", [0.0, 0.005, 0.02, 0.1, 0.3, 0.5, 0.9])
def test_the_threshold_of_a_share_of_outliers_is_the_minimax_one(share):
    memory = spread.begin(1)
    memory[0, [spread.WEIGHT, spread.SHARE]] = 1000.0, share
    assert spread.minimax(memory) == pytest.approx(minimax_threshold(min(max(share, 0.005), 0.5)), rel=5.5e-3)


def test_there_are_at_most_fifty():
    assert count() <= MOST


def count():
    """Return how many numbers the rules have, without those of the arithmetic and the first of the scales, 1."""
    return sum(len(value) for value in stated()[0].values()) - 1


if __name__ == "__main__":
    print(f"{count()} numbers of the rules, {len(stated()[1])} that guard the arithmetic")
