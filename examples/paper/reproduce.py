"""Regenerate the paper's figures 1-19 and test its claims, into one folder with one report.md.

Run ``python examples/paper/reproduce.py`` (a minute or two); ``--only 6 11`` makes some figures alone. The same seed
gives the same report, whatever the number of jobs. ``--compare-loop`` times both studies against a Python loop.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import excitation
import identification_report
import initial_rate
import matplotlib
import scheme
import speed
import state_estimation
from report import Options, write_report

CHOICES = """\
* W of section 4 is lost in the text: 1e-4 I here, with 1e-6 I beside it; steps that would leave the stable plants are
  not made. See "The lost W" below for what speaks for that.
* Sigma_theta is not given: P0 = 0.01 I, theta(0) ~ N(theta_bar, P0) among stable plants, theta_hat(0) = theta_bar.
* N(0, 0.1) and N(0, 10) are read as variances; "log" is the natural logarithm.
* The output-error recursion is kept stable by rejecting unstable steps; its gain uses phi itself, as in Table 1.
* k follows from the contamination by Huber's relation (the one for 0.05 where there is none). In the literal form,
  T = 1, the threshold is in the unit of y.
* Each run takes another 1000 samples of the binary input of figure 7, and other noise and parameters.
* Intervals are bootstrap intervals over runs. "Holds": the whole interval meets the criterion; "does not hold": none of
  it does; "undecided": it straddles it. "Loses nothing" and "no worse" mean at most 1.1 times the squared error.
* The well-conditioned plant: a = [-1.5, 0.7], b = [1, 0.5], noise 0.5 and ten times that, from theta = 0, P0 = I, the
  filtered gradient; T(k) = S^(-1/2) is the robust form judged there, because T = 1 is no valid filter
  from that start."""

PARTS = (
    (scheme, range(1, 2)),
    (state_estimation, range(2, 5)),
    (initial_rate, ()),
    (excitation, range(5, 8)),
    (identification_report, range(8, 20)),
)


def main(argv: list[str] | None = None) -> Path | None:
    """Make every part asked for, and the report; return the report's path, None for a comparison of durations."""
    from tqdm import tqdm

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200, help="runs of each study, at least 2 (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    # Starting processes takes longer than some hundred runs.
    parser.add_argument("--jobs", type=int, default=1, help="processes, -1 for one per processor (default %(default)s)")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "output" / "paper")
    parser.add_argument("--only", type=int, nargs="+", metavar="FIG", help="numbers of figures, 1 to 19")
    parser.add_argument(
        "--compare-loop", action="store_true", help="only time both studies against a Python loop over the samples"
    )
    args = parser.parse_args(argv)
    if args.runs < 2 or (args.only and not set(args.only) <= set(range(1, 20))):
        parser.error("--runs must be at least 2, --only takes figures 1 to 19")
    if args.compare_loop:
        print(speed.report(args.runs, args.seed))
        return None
    matplotlib.use("Agg")
    # The folder of these modules, for processes that joblib starts.
    here = str(Path(__file__).resolve().parent)
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (here, os.environ.get("PYTHONPATH"))))
    args.out.mkdir(parents=True, exist_ok=True)
    options = Options(args.runs, args.seed, args.jobs, args.out, frozenset(args.only) if args.only else None)
    wanted = [module for module, figures in PARTS if options.wants(*figures)]
    parts = [module.make(options) for module in tqdm(wanted, desc="parts")]
    command = f"python examples/paper/reproduce.py --runs {args.runs} --seed {args.seed}"
    path = write_report(parts, CHOICES, options, command)
    claims = [claim for part in parts for claim in part.claims]
    print(f"{path.resolve()} and {sum(len(part.figures) for part in parts)} figures beside it; {len(claims)} claims:")
    for c in claims:
        print(f"  {c.verdict:14} {c.figures:21} {c.claim}  {c.measured}")
    counts = {v: sum(c.verdict == v for c in claims) for v in ("holds", "does not hold", "undecided")}
    print("Conclusion: " + ", ".join(f"{n} claims: {v}" for v, n in counts.items()))
    return path


if __name__ == "__main__":
    main()
