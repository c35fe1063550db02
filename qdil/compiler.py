"""What XLA is told about compiling a program, by what the program does. All of it is for CPUs; others get None."""

from typing import Any

import jax

from qdil._startup import cores

Options = dict[str, Any] | None  # for ``jax.jit(…, compiler_options=…)``


def for_physics(num_devices: int) -> Options:
    """For programs that move robots: a step is hundreds of tiny operations.

    XLA's older code generator is half as fast again at them as its present one, and its library of kernels does not pay
    at this size (docs/performance.md). Numbers differ by rounding.
    """
    return _on_cpu(
        {"xla_cpu_use_fusion_emitters": False, "xla_cpu_experimental_ynn_fusion_type": ""} | _threads(num_devices)
    )


def for_learning(num_devices: int) -> Options:
    """For programs that are mostly matrix products."""
    return _on_cpu(_threads(num_devices))


def in_haste() -> Options:
    """For what begins episodes, once a run or an evaluation: compiling it is what costs."""
    return _on_cpu({"xla_backend_optimization_level": 0})


def _threads(num_devices: int) -> dict[str, Any]:
    """Each device on its own core, where no core is without one: no operation is split, and none beside another."""
    if num_devices < cores() * jax.process_count():
        return {}  # a core without a device can help the others
    return {
        "xla_disable_hlo_passes": "cpu-parallel-task-assigner",
        "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
    }


def _on_cpu(options: dict[str, Any]) -> Options:
    return options if options and jax.default_backend() == "cpu" else None
