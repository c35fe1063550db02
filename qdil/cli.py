"""The command line, a thin layer over the library.

Exit codes: 0 success, 1 failure or interruption, 2 a request that cannot be met. Each command has two functions: the
first adds its options to a parser, and the one below it runs the command.
"""

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
from qdil.runs.studies import STUDIES, experiments_of, name_of

Parser = argparse.ArgumentParser


def _add_robot(parser: Parser) -> None:
    parser.add_argument("--env", required=True, help=f"robot: {', '.join(robot_names())}")


def _add_budget(parser: Parser, default: str = "laptop") -> None:
    parser.add_argument("--budget", default=default, help=f"one of {', '.join(BUDGETS)} (default: {default})")


def _add_seed(parser: Parser) -> None:
    parser.add_argument("--seed", type=int, default=1, help="seed of all randomness (default: 1)")


def _add_seeds(parser: Parser, default: str) -> None:
    parser.add_argument("--seed", type=int, action="append", help=f"repeatable (default: {default})")


# train


def _add_train(parser: Parser) -> None:
    parser.description = (
        "Train one archive. Imitation methods need demonstrations: see 'qdil demos'.\n"
        "To resume an interrupted run from its last checkpoint, give the same command again."
    )
    parser.epilog = settings_help()
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    _add_robot(parser)
    parser.add_argument("--method", required=True, help="a method's name; 'qdil methods' lists them")
    _add_budget(parser)
    _add_seed(parser)
    where = "results/BUDGET/ENV"
    demos = f"demonstrations (default: {where}/demos-N-seed-S.npz, of the expert with the run's own seed)"
    parser.add_argument("--demos", type=Path, metavar="FILE", help=demos)
    change = "change a setting (repeatable)"
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", dest="settings", help=change)
    folder = f"run folder (default: {where}/METHOD/seed-N, with what --set changes in the name)"
    parser.add_argument("--out", type=Path, help=folder)
    parser.add_argument("--devices", type=int, help="local devices to use (default: as many as divide the counts)")
    save = "seconds between checkpoints (default: 20); saving takes at most a few hundredths of the time"
    parser.add_argument("--save-seconds", type=float, metavar="SECONDS", help=save)
    dry_run = "print the settings, the steps and a time estimate; train nothing"
    parser.add_argument("--dry-run", action="store_true", help=dry_run)


def _train(args: argparse.Namespace) -> int:
    changes = parse_settings(args.settings) | ({} if args.devices is None else {"devices": args.devices})
    config = make_config(args.env, args.method, args.budget, args.seed, **changes)
    if args.dry_run:
        from qdil.tools import plan

        print(plan.report(config, plan.plan(config)))
        return 0
    from qdil.devices import hosts
    from qdil.imitation.demo_report import fall_warning_of
    from qdil.runs import summary
    from qdil.runs.folder import folder_of
    from qdil.runs.progress import Progress
    from qdil.runs.train import SAVE_SECONDS, learns_from, train

    hosts.join()
    experiment = name_of(args.method, args.env, args.budget, **changes)
    folder = args.out or folder_of(experiment, args.env, args.budget, args.seed)
    save_seconds = SAVE_SECONDS if args.save_seconds is None else args.save_seconds
    if not hosts.is_first():
        train(config, folder, args.demos, save_seconds=save_seconds)
        return 0
    demos = learns_from(config, args.demos)
    if demos and (warning := fall_warning_of(demos)):
        print(warning, file=sys.stderr)
    progress = Progress(config)
    try:
        trained = train(config, folder, args.demos, progress, save_seconds)
    finally:
        progress.close()
    print(f"The run in {folder} is {'finished' if trained else 'already finished; nothing to do'}.")
    print(summary.sentences(summary.read(folder)))
    return 0


# demos


def _add_demos(parser: Parser) -> None:
    parser.description = (
        "Choose diverse elites of the expert ('--method true') by fresh episodes, and record an episode of each: of "
        "several, the one that is nearest to the elite's measures and does not fall unless all do. Prints a table."
    )
    _add_robot(parser)
    _add_budget(parser)
    parser.add_argument("--seed", type=int, default=1, help="the expert's seed (default: 1)")
    parser.add_argument("--episodes", type=int, help="demonstrations to record (default: 4; smoke: 1)")
    parser.add_argument("--attempts", type=int, help="episodes simulated for each demonstration (default: 16)")
    parser.add_argument("--expert", type=Path, help="the expert's run folder (default: that of --budget and --seed)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="default: results/BUDGET/ENV/demos-N-seed-S.npz")


def _demos(args: argparse.Namespace) -> int:
    config = make_config(args.env, "true", args.budget, args.seed)
    episodes = config.demos.demo_episodes if args.episodes is None else args.episodes
    attempts = config.demos.demo_attempts if args.attempts is None else args.attempts
    for option, count in (("episodes", episodes), ("attempts", attempts)):
        if count < 1:
            raise ConfigError(f"--{option} {count} must be at least 1.")
    from qdil.files import read_npz
    from qdil.imitation.demo_report import report
    from qdil.runs.demos import make_demos

    path = make_demos(args.env, args.budget, episodes, args.seed, args.expert, args.out, attempts)
    print(report(read_npz(path)))
    print(f"Wrote {episodes} demonstration{'s' if episodes > 1 else ''} to {path}.")
    return 0


# figures


def _add_figures(parser: Parser) -> None:
    parser.description = (
        "Write curves, archives and bars of finished runs to results/figures, as PNG and PDF, and a table."
    )
    _add_robot(parser)
    _add_budget(parser)
    _add_seeds(parser, "every finished seed")


def _figures(args: argparse.Namespace) -> int:
    from qdil.evidence.figures import write_figures

    for path in write_figures(args.env, args.budget, args.seed):
        print(f"Wrote {path}.")
    return 0


# claims


def _add_claims(parser: Parser) -> None:
    parser.description = (
        "Print a verdict for every claim and robot, and write the page with all numbers: results/claims.md (laptop), "
        "results/BUDGET/claims.md (other budgets). Trains nothing; takes seconds."
    )
    parser.add_argument("--env", help="judge only this robot, and write no page")
    _add_budget(parser)
    parser.add_argument("--results", type=Path, default=Path("results"), metavar="DIR", help="default: results")


def _claims(args: argparse.Namespace) -> int:
    from qdil.evidence import claims

    if not args.results.is_dir():
        raise ConfigError(f"there is no folder {args.results} with results.")
    verdicts = claims.judge(args.results, args.budget, [args.env] if args.env else None)
    print(claims.plain(verdicts))
    if not args.env:
        print(f"\nWrote {claims.write(verdicts, args.budget, args.results)}.")
    return 0


# diagnose


def _add_diagnose(parser: Parser) -> None:
    parser.description = (
        "Does an imitation work? Print a run's numbers beside what a healthy run shows, with a verdict on each: of its "
        "reward, its archive and its search. Reads the files that exist, so the run need not be finished."
    )
    parser.add_argument("folder", type=Path, nargs="?", metavar="DIR", help="the run's folder (default: by --env …)")
    parser.add_argument("--env", help=f"robot: {', '.join(robot_names())} (default: that of DIR)")
    parser.add_argument("--method", help="a method's name (default: that of DIR)")
    _add_budget(parser)
    _add_seed(parser)
    change = "a setting that the run changed (repeatable; default: none)"
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", dest="settings", help=change)
    parser.add_argument("--json", action="store_true", help="print an object instead of a page (default: a page)")


def _diagnose(args: argparse.Namespace) -> int:
    from qdil.evidence import diagnosis
    from qdil.runs.folder import folder_of

    by_name = args.env is not None and args.method is not None
    if (args.folder is None) != by_name:
        raise ConfigError("diagnose needs either the run's folder, or both --env and --method.")
    folder = args.folder
    if folder is None:
        changes = parse_settings(args.settings)
        folder = folder_of(name_of(args.method, args.env, args.budget, **changes), args.env, args.budget, args.seed)
    found = diagnosis.diagnose(folder)
    print(diagnosis.as_json(found) if args.json else diagnosis.report(found))
    return 0


# verify


def _add_verify(parser: Parser) -> None:
    parser.description = (
        "Hash a run's files again and evaluate a sample of its elites on new episodes. Exit code 1 if a file does "
        "not match the run's manifest."
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="the run's folder")


def _verify(args: argparse.Namespace) -> int:
    from qdil.tools import verify

    found = verify.verify(args.folder)
    print(verify.report(found))
    return 0 if found.sound() else 1


# bench


def _add_bench(parser: Parser) -> None:
    parser.description = (
        "Measure a run's speed as shares of the bare simulator's, robot by robot; takes minutes for each. With "
        "--against, compare whole iterations of true and mconbo-gail with another checkout of this project instead."
    )
    robots = f"one of {', '.join(robot_names())} (default: {', '.join(PAPER_ROBOTS)}; with --against: walker2d)"
    parser.add_argument("--env", action="append", metavar="ENV", help=robots)
    _add_budget(parser)
    parser.add_argument("--rounds", type=int, default=5, help="rounds in which each speed is measured (default: 5)")
    parser.add_argument("--json", action="store_true", help="print an object per robot instead of a table")
    parser.add_argument("--against", type=Path, metavar="CHECKOUT", help="a folder that holds another version of qdil")


def _bench(args: argparse.Namespace) -> int:
    if args.rounds < 1:
        raise ConfigError(f"--rounds {args.rounds} must be at least 1.")
    robots = args.env or (["walker2d"] if args.against else list(PAPER_ROBOTS))
    for env in robots:
        make_config(env, "true", args.budget)
    from qdil.tools import against, bench

    rows: dict[str, bench.Row] = {}
    if args.against:
        against.check(args.against)
        for env in robots:
            rows[env] = against.compare(args.against, env, args.budget, args.rounds)
    elif len(robots) > 1:  # one process per robot, so that none inherits another's memory
        for env in robots:
            rows |= bench.in_own_process(env, args.budget, args.rounds)
    else:
        rows[robots[0]] = bench.everything(robots[0], args.budget, args.rounds)
    print(bench.as_json(rows) if args.json else bench.table(rows))
    return 0


# study


def _add_study(parser: Parser) -> None:
    parser.description = (
        "Train the runs of some studies that are not finished yet, one after the other in this process."
    )
    parser.epilog = f"studies: {', '.join(STUDIES)}"
    parser.add_argument("names", nargs="*", metavar="STUDY", help="studies (default: all)")
    _add_robot(parser)
    _add_budget(parser)
    _add_seeds(parser, "smoke 1, laptop and full 1 2 3")
    parser.add_argument("--dry-run", action="store_true", help="list the runs and whether they exist; train nothing")


def _study(args: argparse.Namespace) -> int:
    from qdil.runs import experiments
    from qdil.runs.folder import folder_of, is_finished

    make_config(args.env, "true", args.budget)
    names, seeds = experiments_of(args.names or STUDIES, args.budget), args.seed
    if args.dry_run:
        for name in names:
            for seed in seeds or experiments.SEEDS[args.budget]:
                folder = folder_of(name, args.env, args.budget, seed)
                print(f"{'finished' if is_finished(folder) else 'missing':8}  {folder}")
        return 0
    from qdil.runs.missing import train_missing
    from qdil.runs.progress import Progress

    train_missing(names, args.env, args.budget, seeds, report=Progress)
    return 0


# methods


def _add_methods(parser: Parser) -> None:
    parser.description = "List every method with a line each."


def _methods(args: argparse.Namespace) -> int:
    names = method_names()
    for name in names:
        print(f"{name:{max(map(len, names))}}  {describe(name)}")
    return 0


# notebooks


def _add_notebooks(parser: Parser) -> None:
    parser.description = (
        "Execute notebooks, scheduled by Snakemake, into copies with outputs: results/notebooks/BUDGET. Notebooks load "
        "finished runs; at smoke, missing runs are trained first, which takes minutes."
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="notebooks, e.g. 05_mconbo_gail (default: all)")
    _add_budget(parser, "smoke")
    parser.add_argument("--env", default="walker2d", help=f"robot: {', '.join(robot_names())} (default: walker2d)")
    parser.add_argument("--seed", type=int, default=1, help="the notebooks' seed (default: 1)")
    parser.add_argument("-j", type=int, default=2, metavar="N", help="notebooks at a time (default: 2)")
    parser.add_argument("--train", action="store_true", help="also train missing runs at laptop and full: takes hours")
    limit = "limit for each notebook (default: 30)"
    parser.add_argument("--timeout", type=float, default=30.0, metavar="MINUTES", help=limit)


def _notebooks(args: argparse.Namespace) -> int:
    from qdil.series import schedule

    failures = schedule.execute_all(
        schedule.Order(args.names, args.budget, args.env, args.seed, args.j, args.train, args.timeout)
    )
    for failure in failures:
        print(failure, file=sys.stderr)
    return 1 if failures else 0


# All commands

# Name -> a line for ``qdil --help``, the function that adds the options, and the one that runs the command.
COMMANDS = {
    "train": ("train one archive with one method", _add_train, _train),
    "demos": ("record demonstrations of a trained expert", _add_demos, _demos),
    "figures": ("draw the finished runs of a robot", _add_figures, _figures),
    "claims": ("judge the paper's claims from finished runs", _add_claims, _claims),
    "diagnose": ("ask whether an imitation works", _add_diagnose, _diagnose),
    "verify": ("check a finished run", _add_verify, _verify),
    "bench": ("measure speed on this machine", _add_bench, _bench),
    "study": ("train the runs that a figure or table needs", _add_study, _study),
    "methods": ("list all methods", _add_methods, _methods),
    "notebooks": ("execute the notebooks headlessly", _add_notebooks, _notebooks),
}


def _parser() -> Parser:
    parser = Parser(prog="qdil", description="Quality-diversity imitation learning (PPGA, MConbo-GAIL).")
    _add_import(parser)
    commands = parser.add_subparsers(dest="command", required=True)
    for name, (help_line, add_options, run) in COMMANDS.items():
        command = commands.add_parser(name, help=help_line)
        add_options(command)
        command.set_defaults(run=run)
    return parser


def _add_import(parser: Parser) -> None:
    own = "a module of your own that registers reward models or robots (repeatable; before the command)"
    parser.add_argument("--import", action="append", default=[], metavar="MODULE", dest="modules", help=own)


def _imports(argv: list[str]) -> list[str]:
    """The modules that ``--import`` names. They are loaded first, because the help of other options lists methods."""
    parser = Parser(add_help=False, exit_on_error=False)
    _add_import(parser)
    try:
        return parser.parse_known_args(argv)[0].modules
    except argparse.ArgumentError:
        return []  # the complete parser prints the error


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    # Imports and tracing create millions of objects that stay. Searching them for garbage takes a tenth of a start.
    gc.set_threshold(100_000, 20, 20)
    atexit.register(gc.freeze)  # so that the collection at exit skips them, too
    try:
        use_all_cores()  # before a user's module can start JAX's devices
        plugins.request(_imports(sys.argv[1:] if argv is None else argv))
        args = _parser().parse_args(argv)
        return args.run(args)
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
