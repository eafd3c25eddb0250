"""Compute the stored results of the book: interrupt at will, start again to go on."""

import argparse
import os
from pathlib import Path


def main(arguments: list[str] | None = None) -> int:
    """Run the command; the exit status is 1 if a case failed."""
    os.environ.setdefault(
        "OMP_NUM_THREADS", "1"
    )  # one thread in each of the processes started here
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from tqdm import tqdm

    from esfem_core.companion import campaign
    from esfem_core.companion.experiments import EXPERIMENTS

    names = {experiment.name: experiment for experiment in EXPERIMENTS}
    listing = "\n".join(f"  {name:<28} {names[name].title}" for name in names)
    parser = argparse.ArgumentParser(
        prog="python -m esfem_core.companion.experiments",
        description=__doc__,
        epilog=f"experiments:\n{listing}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="name", help="experiments to run (all)")
    parser.add_argument("--folder", type=Path, default=Path("book/data"), help="%(default)s")
    parser.add_argument("--jobs", type=int, help="processes (one for each core)")
    options = parser.parse_args(arguments)
    if unknown := set(options.names) - set(names):
        parser.error(f"no such experiment: {', '.join(sorted(unknown))}")
    if options.jobs is not None and options.jobs < 1:
        parser.error(f"--jobs must be at least 1, but is {options.jobs}")

    chosen = [names[name] for name in options.names or names]
    total = sum(len(chain) for experiment in chosen for chain in experiment.chains)
    failures = 0
    with tqdm(total=total, unit="case") as bar:
        for experiment, outcome, cases in campaign.run(chosen, options.folder, options.jobs):
            if isinstance(outcome, Exception):
                failures += 1
                bar.write(f"{experiment.name}: {type(outcome).__name__}: {outcome}")
            bar.set_description(experiment.name)
            bar.update(cases)
    return min(failures, 1)


if __name__ == "__main__":
    raise SystemExit(main())
