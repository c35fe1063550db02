"""What XLA is told about compiling a program, by what the program does. All of it is for CPUs; others get None."""

from typing import Any

import jax

from qdil._startup import cores

Options = dict[str, Any] | None  # for ``jax.jit(…, compiler_options=…)``


def for_learning(num_devices: int) -> Options:
    """Each device on its own core, where no core is without one; otherwise those without help with large products."""
    return None if num_devices < cores() * jax.process_count() else on_one_core()


def on_one_core() -> Options:
    """No operation is split, and none runs beside another: right for physics, whose operations are hundreds and short.

    Two cores for one device took longer over most, by a tenth, and by a half where a machine was slow to wake threads.
    """
    return _on_cpu(
        {
            "xla_disable_hlo_passes": "cpu-parallel-task-assigner",
            "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
        }
    )


def in_haste() -> Options:
    """For what begins episodes, once a run or an evaluation: compiling it is what costs."""
    return _on_cpu({"xla_backend_optimization_level": 0})


def _on_cpu(options: dict[str, Any]) -> Options:
    return options if jax.default_backend() == "cpu" else None
