"""Compute the stored results of the book: interrupt at will, start again to go on."""

import argparse
import json
import sys
from collections.abc import Mapping
from contextlib import closing, nullcontext
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from esfem_core.checks import whole_number
from esfem_core.companion import campaign
from esfem_core.companion.experiments import EXPERIMENTS
from esfem_core.study import Experiment, outcomes


def main(arguments: list[str] | None = None) -> int:
    """Run the command; the exit status is 1 if a case failed, 130 if it was interrupted."""
    options = _options(arguments)
    try:
        return _renew(options) if options.stale else _run(options)
    except KeyboardInterrupt:
        print("interrupted: what is finished is kept, start again to go on", file=sys.stderr)
        return 130


def _run(options: argparse.Namespace) -> int:
    """Compute what is missing; 1 if a case failed."""
    total = sum(len(chain) for experiment in options.experiments for chain in experiment.chains)
    failures, found = 0, 0
    coming = outcomes(options.experiments, options.folder, workers=options.jobs)
    with closing(coming), _progress(total) as bar:
        for o in coming:
            if o.error:
                failures += 1
                bar.write(_failed(_called(o.experiment, o.parameters), o.error))
            found += o.found
            bar.set_description(o.experiment.name)
            bar.update(o.cases)
    if found == total:
        print(f"all is stored in {options.folder} already: another --folder computes it anew")
    if stale := _count_stale(options):
        print(f"{stale} stored cases were computed by other code: --stale computes them again")
    return min(failures, 1)


def _renew(options: argparse.Namespace) -> int:
    """Compute again what other code has computed, and list what came out differently."""
    failures = 0
    with _progress(_count_stale(options)) as bar:
        for experiment, old, outcome in campaign.renew(
            options.experiments, options.folder, options.jobs
        ):
            name = _called(experiment, old.parameters)
            if isinstance(outcome, Exception):
                failures += 1
                bar.write(_failed(name, outcome))
            else:
                for where, before, after in campaign.changes(old.results, outcome.results):
                    bar.write(f"{name}: {where} was {before}, is {after}")
            bar.set_description(experiment.name)
            bar.update()
    return min(failures, 1)


def _called(experiment: Experiment, parameters: Mapping[str, Any]) -> str:
    return f"{experiment.name} {json.dumps(parameters)}"


def _failed(name: str, error: Exception) -> str:
    return f"{name}: {type(error).__name__}: {error}"


def _progress(total: int) -> Any:
    """The bar of tqdm, or lines where there is none: it is no dependency of the solver."""
    try:
        from tqdm import tqdm
    except ImportError:
        return nullcontext(_Lines(total))
    return tqdm(total=total, unit="case")


class _Lines:
    """What `_run` and `_renew` ask of a bar, in a line for each outcome."""

    def __init__(self, total: int) -> None:
        self.total, self.done, self.name = total, 0, ""

    def write(self, text: str) -> None:
        print(text, flush=True)

    def set_description(self, name: str) -> None:
        self.name = name

    def update(self, cases: int = 1) -> None:
        self.done += cases
        print(f"{self.done}/{self.total} {self.name}", file=sys.stderr, flush=True)


def _count_stale(options: argparse.Namespace) -> int:
    return sum(
        not campaign.is_current(experiment, row)
        for experiment in options.experiments
        for row in campaign.read(options.folder / f"{experiment.name}.jsonl")
    )


def _options(arguments: list[str] | None) -> argparse.Namespace:
    """What the command line asks for: experiments, folder, jobs, which cases."""
    names = {experiment.name: experiment for experiment in EXPERIMENTS}
    listing = "\n".join(f"  {name:<28} {names[name].title}" for name in names)
    parser = argparse.ArgumentParser(
        prog="python -m esfem_core.companion.experiments",
        description=__doc__,
        epilog=f"experiments:\n{listing}\n\nmeshes of the distance function, in nick_figures_1_3, "
        "nick_figures_2_4 and nick_coupling, need scikit-image, the extra mesh\n"
        "lmv_run_times and nick_mass_runtime measure time: run them alone, with --jobs 1, on a "
        "machine that does nothing else",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="name", help="experiments to run (all)")
    parser.add_argument(
        "--folder",
        type=Path,
        default=campaign.DATA,
        help="where to keep the results (in the package, where the book reads them: %(default)s)",
    )
    parser.add_argument("--jobs", type=int, help="processes (one for each core)")
    parser.add_argument(
        "--stale",
        action="store_true",
        help="compute again the stored cases that other code has computed, and those only; numbers "
        "that change by more than 1 %% are listed",
    )
    options = parser.parse_args(arguments)
    if unknown := set(options.names) - set(names):
        parser.error(
            f"no such experiment: {', '.join(sorted(unknown))}; there are {', '.join(names)}"
        )
    options.experiments = [names[name] for name in dict.fromkeys(options.names or names)]
    try:
        if options.jobs is not None:
            options.jobs = whole_number("--jobs", options.jobs, 1)
        options.folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=options.folder).close()
        for experiment in options.experiments:
            campaign.read(experiment.path(options.folder))  # refuses what is no file of results
    except ValueError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(
            f"cannot write into {options.folder} ({error.strerror}); choose a folder with --folder"
        )
    return options


if __name__ == "__main__":
    raise SystemExit(main())
