"""What XLA is told about compiling a program, by what the program does. All of it is for CPUs; others get None."""

from typing import Any

import jax

from qdil._startup import cores

Options = dict[str, Any] | None  # for ``jax.jit(…, compiler_options=…)``


def for_speed(num_devices: int) -> Options:
    """Each device on its own core, where no core is without one: no operation is split, and none beside another."""
    if num_devices < cores() * jax.process_count():
        return None  # a core without a device can help the others
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
