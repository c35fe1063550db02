"""XLA's compiler options by kind of program. They are for CPUs; on other devices they are None."""

from typing import Any

import jax

from qdil.devices.start import cores

Options = dict[str, Any] | None  # for ``jax.jit(…, compiler_options=…)``


def ppo_options(num_devices: int) -> Options:
    """For PPO's learning: if every core hosts a device, pin each device to its core.

    Otherwise let XLA spread large matrix products over the idle cores.
    """
    return None if num_devices < cores() * jax.process_count() else single_threaded(num_devices)


def single_threaded(num_devices: int) -> Options:
    """For physics: no operation is split over threads, and operations run one after the other.

    A step of physics is hundreds of short operations, most of which take longer if two cores share them: a tenth
    longer, or half as long again on machines that wake threads slowly.
    """
    return _on_cpu(
        {
            "xla_disable_hlo_passes": "cpu-parallel-task-assigner",
            "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
        }
    )


def unoptimised(num_devices: int) -> Options:
    """For programs that begin episodes: they run so rarely that compiling them takes longer than running them."""
    return _on_cpu({"xla_backend_optimization_level": 0})


def _on_cpu(options: dict[str, Any]) -> Options:
    return options if jax.default_backend() == "cpu" else None
