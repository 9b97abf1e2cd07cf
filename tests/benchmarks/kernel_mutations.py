"""How many wrong lines of C do the tests see? The kernel is built once with many wrong lines, of which one is chosen.

    python tests/benchmarks/kernel_mutations.py [--count 30] [--seed 0] [--limit 60] [--file joint.h] [--pick 3 7]

Lines are drawn at random over the headers of the kernel, where its arithmetic is. Each is compiled both right and
wrong; the environment variable MUTATION says which is wrong in this process. A line counts as seen if a test that is
named below fails, or the process crashes, within the limit in seconds of processor time, once for the tests that come
near it and once for all. --pick runs only some of the lines drawn.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from mutations import seen, seen_by_what_passes

ROOT = Path(__file__).parents[2]
HEADERS = ROOT / "robust_filterpy" / "kernel"
# Of glue.h and groups.h no line computes; of real.h each is the name of a function of C.
LEFT_OUT = ("glue.h", "groups.h", "real.h", "online.h")
# What compares the kernel with the definition: for a header first what comes near it, then all.
FIRST = {
    "tracker.h": ("tests/kernel/test_tracker_kernel.py", "tests/identification/test_tracker_bank.py"),
    "mend.h": ("tests/kernel/test_tracker_kernel.py",),
    "learnt.h": ("tests/kernel/test_learnt_kernel.py", "tests/kernel/test_steps.py"),
    "smoother.h": ("tests/smoothing/test_linear_pass.py", "tests/smoothing/test_smoother.py"),
    "series.h": ("tests/batch",),
}
EVERY = ("tests/kernel", "tests/batch")
SWAPPED = {
    "+": "-", "-": "+", "*": "/", "/": "*", "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==",
    "&&": "||", "||": "&&", "+=": "-=", "-=": "+=", "*=": "/=",
}  # fmt: skip
OPERATOR = re.compile(r" ([+*/<>-]|<=|>=|==|!=|&&|\|\||[+*-]=) ")
NUMBER = re.compile(r"REAL\([\d.e+-]+\)|(?<![\w.])\d+(?![\w.(])")


def closed(text: str, begin: int) -> int:
    """Return where the parenthesis that opens at begin has closed, -1 if not on this line."""
    depth = 0
    for k in range(begin, len(text)):
        depth += (text[k] == "(") - (text[k] == ")")
        if depth == 0:
            return k
    return -1


def spans(line: str) -> Iterator[tuple[int, int, bool]]:
    """Yield what of a line is a whole expression or a whole statement: where it begins and ends, and which it is."""
    begin = len(line) - len(line.lstrip())
    while found := re.match(r"(?:\} )?(?:else )?(for|if|while) \(", line[begin:]):
        opened = begin + found.end() - 1
        end = closed(line, opened)
        if end < 0:
            return
        if found.group(1) != "for":
            yield opened + 1, end, False
        begin = end + 2
    rest = line[begin:]
    if found := re.match(r"return (.+);$", rest):
        yield begin + found.start(1), begin + found.end(1), False
    elif found := re.match(r"(?:const )?(?:real|int) \w+ = ([^,]+);$", rest):
        yield begin + found.start(1), begin + found.end(1), False
    elif found := re.match(r"[\w>\[\]. *+-]+ [-+*/]?= .+;$", rest):
        if not re.match(r"(const|static|real|int|size_t|struct|\w+ \*?const|\w+ \*RESTRICT|\w+ \w+ =)\b", rest):
            yield begin, begin + len(rest), True


def wrong(text: str, rng: random.Random) -> str | None:
    """Return text with an operator or a number changed, None if there is none."""
    if text == "1":
        # Where that is a truth, another number is the same.
        return "0"
    found = [(m.start(1), m.end(1), SWAPPED[m.group(1)]) for m in OPERATOR.finditer(text)]
    for m in NUMBER.finditer(text):
        found.append((m.start(), m.end(), f"({m.group()} + 1)"))
    if not found:
        return None
    begin, end, other = rng.choice(found)
    return text[:begin] + other + text[end:]


def drawn(count: int, seed: int, name: str) -> list[tuple[Path, int, str, str]]:
    """Return file, line, what is there and what instead, drawn with equal chances for each line."""
    rng, lines = random.Random(seed), []
    for path in sorted(HEADERS.glob("*.h")):
        if path.name in LEFT_OUT or (name and path.name != name):
            continue
        for number, line in enumerate(path.read_text().split("\n")):
            constant = re.match(r"#define \w+ (REAL\([\d.e+-]+\))", line)
            whole = [(*constant.span(1), False)] if constant else [] if "/*" in line else list(spans(line))
            if whole:
                lines.append((path, number, line, whole))
    chosen = []
    for path, number, line, whole in rng.sample(lines, min(count, len(lines))):
        begin, end, statement = rng.choice(whole)
        spoilt = wrong(line[begin:end], rng)
        if spoilt is not None:
            k = len(chosen) + 1
            both = (
                f"{{ if (MUTATION({k})) {{ {spoilt} }} else {{ {line[begin:end]} }} }}"
                if statement
                else f"(MUTATION({k}) ? ({spoilt}) : ({line[begin:end]}))"
            )
            chosen.append((path, number, line[begin:end], spoilt, line[:begin] + both + line[end:]))
    return chosen


def build(copy: Path, chosen: list[tuple[Path, int, str, str, str]]) -> None:
    """Put the wrong lines next to the right ones and build."""
    for path, number, _, _, both in chosen:
        place = copy / path.relative_to(ROOT)
        lines = place.read_text().split("\n")
        lines[number] = both
        place.write_text("\n".join(lines))
    real = copy / "robust_filterpy" / "kernel" / "real.h"
    lines = real.read_text().split("\n")
    at = next(k for k, line in enumerate(lines) if line.startswith("#define ROBUST_FILTERPY_REAL_H"))
    lines.insert(at + 1, "extern int mutation_chosen;\n#define MUTATION(k) (mutation_chosen == (k))")
    real.write_text("\n".join(lines))
    module = copy / "robust_filterpy" / "kernel" / "module.c"
    module.write_text(
        module.read_text()
        + "\n#include <stdlib.h>\nint mutation_chosen = 0;\n__attribute__((constructor)) static void choose(void)"
        ' { const char *k = getenv("MUTATION"); mutation_chosen = k ? atoi(k) : 0; }\n'
    )
    environment = {**os.environ, "ROBUST_FILTERPY_CFLAGS": "-O1"}
    for old in (copy / "robust_filterpy" / "kernel").glob("*.so"):
        old.unlink()
    subprocess.run([sys.executable, "setup.py", "-q", "build_ext", "--inplace"], cwd=copy, env=environment, check=True)
    if not list((copy / "robust_filterpy" / "kernel").glob("*.so")):
        raise SystemExit("the kernel with the wrong lines next to the right ones does not compile")


def main() -> None:
    """Choose the wrong lines one at a time and print which were seen, and the share in each file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=60.0)
    parser.add_argument("--file", default="")
    parser.add_argument("--pick", type=int, nargs="*", default=())
    args = parser.parse_args()
    total, killed = Counter[str](), Counter[str]()
    passing: set[str] = set()
    failing: set[str] = set()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in ("robust_filterpy", "tests", "examples", "docs"):
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__", "_build"))
        for name in ("pyproject.toml", "setup.cfg", "setup.py", "README.md"):
            shutil.copy(ROOT / name, copy)
        chosen = drawn(args.count, args.seed, args.file)
        build(copy, chosen)
        for k, (path, number, right, spoilt, _) in enumerate(chosen, 1):
            if args.pick and k not in args.pick:
                continue

            def spoilt_run(without: set[str], path=path, k=k) -> str:
                first = FIRST.get(path.name, ("tests/kernel/test_steps.py",))
                by = seen(copy, first, args.limit, without, MUTATION=str(k))
                return seen(copy, EVERY, args.limit, without, MUTATION=str(k)) if by.startswith("(") else by

            by = seen_by_what_passes(
                spoilt_run,
                lambda test: seen(copy, [test], args.limit, MUTATION="0"),
                passing,
                failing,
            )
            total[path.name] += 1
            survived = by.startswith("(")
            killed[path.name] += not survived
            change = f"{right.strip()}  ->  {spoilt.strip()}"
            print(f"{'SURVIVED' if survived else 'seen    '} {k} {path.name}:{number + 1}  {change}  {by}", flush=True)
    for name, number in sorted(total.items()):
        print(f"{name:16} {killed[name]:3d} of {number:3d}")
    print(f"seen: {sum(killed.values())} of {sum(total.values())}")


if __name__ == "__main__":
    main()
