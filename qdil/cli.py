"""The command line, thin over the library; exit code 0 done, 1 failed or interrupted, 2 a request it cannot meet."""

import argparse
import atexit
import gc
import os
import sys
from pathlib import Path

from qdil import plugins
from qdil.config import BUDGETS, make_config, parse_settings, settings_help
from qdil.devices.start import use_all_cores
from qdil.errors import ConfigError
from qdil.methods import describe, method_names
from qdil.robots.register import PAPER_ROBOTS, robot_names
from qdil.runs.studies import STUDIES, experiments_of


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="qdil", description="Quality-diversity imitation learning (PPGA, MConbo-GAIL)."
    )
    _add_import(parser)
    commands = parser.add_subparsers(dest="command", required=True)

    train = commands.add_parser(
        "train",
        help="train one archive with one method",
        description="Train one archive. Imitation methods need demonstrations: see 'qdil demos'. An interrupted run "
        "goes on from its last checkpoint when the same command is given again; one is written every 20 seconds, or "
        "as many as the variable QDIL_SAVE_SECONDS says.",
        epilog=settings_help(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    train.add_argument("--env", required=True, help=f"robot: {', '.join(robot_names())}")
    train.add_argument("--method", required=True, help="a method's name; 'qdil methods' lists them")
    _budget_and_seed(train)
    train.add_argument(
        "--demos", type=Path, metavar="FILE", help="demonstrations (default: results/BUDGET/ENV/demos-N.npz)"
    )
    train.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        dest="settings",
        help="change a setting (repeatable)",
    )
    train.add_argument(
        "--out",
        type=Path,
        help="run folder (default: results/BUDGET/ENV/METHOD/seed-N, with what --set changes in the name)",
    )
    train.add_argument("--devices", type=int, help="local devices to use (default: as many as divide the counts)")
    train.add_argument(
        "--dry-run", action="store_true", help="print the settings, the steps and a time estimate; train nothing"
    )

    demos = commands.add_parser(
        "demos",
        help="record demonstrations of a trained expert",
        description="Choose diverse elites of the expert ('--method true') and record an episode of each.",
    )
    demos.add_argument("--env", required=True, help=f"robot: {', '.join(robot_names())}")
    _budget_and_seed(demos)
    demos.add_argument("--episodes", type=int, help="demonstrations to record (default: 4; smoke: 1)")
    demos.add_argument("--expert", type=Path, help="the expert's run folder (default: that of --budget and --seed)")
    demos.add_argument("--out", type=Path, metavar="FILE", help="default: results/BUDGET/ENV/demos-N.npz")

    figures = commands.add_parser(
        "figures",
        help="draw the finished runs of a robot",
        description="Write curves, archives and bars of finished runs to results/figures, as PNG and PDF, and a table.",
    )
    figures.add_argument("--env", required=True, help=f"robot: {', '.join(robot_names())}")
    figures.add_argument("--budget", default="laptop", help=f"one of {', '.join(BUDGETS)} (default: laptop)")
    figures.add_argument("--seed", type=int, action="append", help="repeatable (default: every finished seed)")

    claims = commands.add_parser(
        "claims",
        help="judge the paper's claims from finished runs",
        description="Print a verdict for every claim and robot, and write the page with all numbers: results/claims.md "
        "(laptop), results/BUDGET/claims.md (other budgets). Trains nothing; takes seconds.",
    )
    claims.add_argument("--env", help="judge this robot alone, and write no page")
    claims.add_argument("--budget", default="laptop", help=f"one of {', '.join(BUDGETS)} (default: laptop)")
    claims.add_argument("--results", type=Path, default=Path("results"), metavar="DIR", help="default: results")

    verify = commands.add_parser(
        "verify",
        help="check a finished run",
        description="Hash a run's files again and evaluate a sample of its elites on new episodes. Exit code 1 if a "
        "file is not what the run's manifest says.",
    )
    verify.add_argument("folder", type=Path, metavar="DIR", help="the run's folder")

    bench = commands.add_parser(
        "bench",
        help="measure speed on this machine",
        description="Measure a run's speed as shares of the bare simulator's, robot by robot; takes minutes for each.",
    )
    bench.add_argument(
        "--env", action="append", metavar="ENV", help=f"one of {', '.join(robot_names())} (default: all)"
    )
    bench.add_argument("--budget", default="laptop", help=f"one of {', '.join(BUDGETS)} (default: laptop)")
    bench.add_argument("--rounds", type=int, default=5, help="turns that each speed is taken in (default: 5)")
    bench.add_argument("--json", action="store_true", help="print an object per robot instead of a table")

    study = commands.add_parser(
        "study",
        help="train the runs that a figure or table needs",
        description="Train, one after the other in this process, the runs of some studies that are not finished yet.",
        epilog=f"studies: {', '.join(STUDIES)}",
    )
    study.add_argument("names", nargs="*", metavar="STUDY", help="studies (default: all)")
    study.add_argument("--env", required=True, help=f"robot: {', '.join(robot_names())}")
    study.add_argument("--budget", default="laptop", help=f"one of {', '.join(BUDGETS)} (default: laptop)")
    study.add_argument("--seed", type=int, action="append", help="repeatable (default: smoke 1, laptop and full 1 2 3)")
    study.add_argument("--dry-run", action="store_true", help="list the runs and whether they are there; train nothing")

    commands.add_parser("methods", help="list all methods", description="List every method with a line each.")

    notebooks = commands.add_parser(
        "notebooks",
        help="execute the notebooks headlessly",
        description="Execute notebooks, scheduled by Snakemake, into copies with outputs: results/notebooks/BUDGET. "
        "Notebooks load finished runs; at smoke those that are missing are trained first, in minutes.",
    )
    notebooks.add_argument("names", nargs="*", metavar="NAME", help="notebooks, e.g. 05_mconbo_gail (default: all)")
    notebooks.add_argument("--budget", default="smoke", help=f"one of {', '.join(BUDGETS)} (default: smoke)")
    notebooks.add_argument("--env", default="walker2d", help=f"robot: {', '.join(robot_names())} (default: walker2d)")
    notebooks.add_argument("--seed", type=int, default=1, help="the notebooks' seed (default: 1)")
    notebooks.add_argument("-j", type=int, default=2, metavar="N", help="notebooks at a time (default: 2)")
    notebooks.add_argument(
        "--train", action="store_true", help="train missing runs first at laptop and full, too: hours"
    )
    notebooks.add_argument(
        "--timeout", type=float, default=30.0, metavar="MINUTES", help="limit for each notebook (default: 30)"
    )
    return parser


def _add_import(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--import",
        action="append",
        default=[],
        metavar="MODULE",
        dest="modules",
        help="a module of your own that registers reward models or robots (repeatable; before the command)",
    )


def _imports(argv: list[str]) -> list[str]:
    """The modules that ``--import`` names: they must be loaded before the names of methods and robots are known."""
    parser = argparse.ArgumentParser(add_help=False, exit_on_error=False)
    _add_import(parser)
    try:
        return parser.parse_known_args(argv)[0].modules
    except argparse.ArgumentError:
        return []  # the whole parser says what is wrong


def _budget_and_seed(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--budget", default="laptop", help=f"one of {', '.join(BUDGETS)} (default: laptop)")
    parser.add_argument("--seed", type=int, default=1, help="seed of all randomness (default: 1)")


def _train(args: argparse.Namespace) -> int:
    changes = parse_settings(args.settings) | ({} if args.devices is None else {"devices": args.devices})
    config = make_config(args.env, args.method, args.budget, args.seed, **changes)
    if args.dry_run:
        from qdil.tools import plan

        print(plan.report(config, plan.plan(config)))
        return 0
    from qdil.devices import hosts
    from qdil.runs import studies
    from qdil.runs.folder import folder_of
    from qdil.runs.progress import Progress
    from qdil.runs.train import train

    hosts.join()
    experiment = studies.name_of(args.method, args.env, args.budget, **changes)
    folder = args.out or folder_of(experiment, args.env, args.budget, args.seed)
    if not hosts.is_first():
        train(config, folder, args.demos)
        return 0
    progress = Progress(config)
    try:
        trained = train(config, folder, args.demos, progress)
    finally:
        progress.close()
    print(f"The run in {folder} is {'finished' if trained else 'already finished; nothing to do'}.")
    return 0


def _demos(args: argparse.Namespace) -> int:
    config = make_config(args.env, "true", args.budget, args.seed)
    episodes = config.demos.demo_episodes if args.episodes is None else args.episodes
    if episodes < 1:
        raise ConfigError(f"--episodes {episodes} must be at least 1.")
    from qdil.runs.demos import make_demos

    path = make_demos(args.env, args.budget, episodes, args.seed, args.expert, args.out)
    print(f"Wrote {episodes} demonstrations to {path}.")
    return 0


def _figures(args: argparse.Namespace) -> int:
    from qdil.evidence.figures import write_figures

    for path in write_figures(args.env, args.budget, args.seed):
        print(f"Wrote {path}.")
    return 0


def _claims(args: argparse.Namespace) -> int:
    from qdil.evidence import claims

    if not args.results.is_dir():
        raise ConfigError(f"there is no folder {args.results} with results.")
    verdicts = claims.judge(args.results, args.budget, [args.env] if args.env else None)
    print(claims.plain(verdicts))
    if not args.env:
        print(f"\nWrote {claims.write(verdicts, args.budget, args.results)}.")
    return 0


def _verify(args: argparse.Namespace) -> int:
    from qdil.tools import verify

    found = verify.verify(args.folder)
    print(verify.report(found))
    return 0 if found.sound() else 1


def _bench(args: argparse.Namespace) -> int:
    if args.rounds < 1:
        raise ConfigError(f"--rounds {args.rounds} must be at least 1.")
    robots = args.env or list(PAPER_ROBOTS)
    for env in robots:
        make_config(env, "true", args.budget)
    from qdil.tools import bench

    rows: dict[str, bench.Row] = {}
    if len(robots) > 1:  # a process each, so that none inherits another's memory
        for env in robots:
            rows |= bench.in_a_process_of_its_own(env, args.budget, args.rounds)
    else:
        rows[robots[0]] = bench.everything(robots[0], args.budget, args.rounds)
    print(bench.as_json(rows) if args.json else bench.table(rows))
    return 0


def _study(args: argparse.Namespace) -> int:
    from qdil.runs import experiments
    from qdil.runs.folder import folder_of, is_finished
    from qdil.runs.missing import train_missing
    from qdil.runs.progress import Progress

    make_config(args.env, "true", args.budget)
    names, seeds = experiments_of(args.names or STUDIES, args.budget), args.seed
    if args.dry_run:
        for name in names:
            for seed in seeds or experiments.SEEDS[args.budget]:
                folder = folder_of(name, args.env, args.budget, seed)
                print(f"{'finished' if is_finished(folder) else 'missing':8}  {folder}")
        return 0
    train_missing(names, args.env, args.budget, seeds, report=Progress)
    return 0


def _methods(args: argparse.Namespace) -> int:
    names = method_names()
    for name in names:
        print(f"{name:{max(map(len, names))}}  {describe(name)}")
    return 0


def _notebooks(args: argparse.Namespace) -> int:
    from qdil.series import schedule

    failures = schedule.execute_all(
        schedule.Order(args.names, args.budget, args.env, args.seed, args.j, args.train, args.timeout)
    )
    for failure in failures:
        print(failure, file=sys.stderr)
    return 1 if failures else 0


COMMANDS = {
    "train": _train,
    "demos": _demos,
    "figures": _figures,
    "claims": _claims,
    "verify": _verify,
    "bench": _bench,
    "study": _study,
    "methods": _methods,
    "notebooks": _notebooks,
}


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    # Imports and tracing make millions of objects that stay: looking for garbage among them is a tenth of a start.
    gc.set_threshold(100_000, 20, 20)
    atexit.register(gc.freeze)  # nor among them once more when the process ends
    try:
        plugins.request(_imports(sys.argv[1:] if argv is None else argv))
        args = _parser().parse_args(argv)
        use_all_cores()
        return COMMANDS[args.command](args)
    except ConfigError as error:
        print(f"qdil: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        sys.stdout = open(os.devnull, "w")
        return 1
    except OSError as error:  # a folder that cannot be written, a full disk
        what = f"{error.filename}: {error.strerror}." if error.filename and error.strerror else error
        print(f"qdil: {what}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("qdil: interrupted.", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
