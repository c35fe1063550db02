"""Options for XLA by the kind of program. All of them are for CPUs; on other devices they are None."""

from typing import Any

import jax

from qdil.devices.start import cores

Options = dict[str, Any] | None  # for ``jax.jit(…, compiler_options=…)``


def ppo_options(num_devices: int) -> Options:
    """For learning: if every core hosts a device, pin each device to its core.

    Otherwise let XLA spread large matrix products over the idle cores.
    """
    return None if num_devices < cores() * jax.process_count() else single_threaded(num_devices)


def single_threaded(num_devices: int) -> Options:
    """For physics: no operation is split over threads, and none runs beside another.

    A step of physics is hundreds of short operations. Two cores for one device took longer over most of them: by a
    tenth, and by a half on machines that are slow to wake threads.
    """
    return _on_cpu(
        {
            "xla_disable_hlo_passes": "cpu-parallel-task-assigner",
            "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
        }
    )


def unoptimised(num_devices: int) -> Options:
    """For programs that begin episodes, once a run or an evaluation: their compilation costs more than their runs."""
    return _on_cpu({"xla_backend_optimization_level": 0})


def _on_cpu(options: dict[str, Any]) -> Options:
    return options if jax.default_backend() == "cpu" else None
