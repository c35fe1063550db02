"""How a program is declared: a method with the layout of its arguments and results, compiled when first called.

A class of programs has one decorated method per program. ``programs.collect(…)`` calls the compiled method;
``programs.collect.lower(…)`` traces it and gives its results as shapes in their layouts, which is all that
ahead-of-time compilation needs (``qdil.engine.aot``). A type checker sees the method's own types in a call.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, TypeVar, overload

import jax
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from qdil.devices.mesh import AXIS
from qdil.devices.xla_options import Options

Args = ParamSpec("Args")
Result = TypeVar("Result")

# Layouts of arrays over the devices.
REPLICATED = P()  # whole on every device
SHARDED = P(AXIS)  # the leading axis split: environments, episodes or candidates
ROLLOUT = P(None, AXIS)  # (T, E, …)
CHUNKS = P(None, None, AXIS)  # (C, T, E, …)

Layout = P | tuple[P, ...]  # one for all of a program's arguments or results, or one for each


class HasMesh(Protocol):
    """What a class needs to declare programs."""

    mesh: Mesh


@dataclass(frozen=True)
class Program(Generic[Args, Result]):
    """A compiled function and the layout of its results."""

    name: str
    function: Callable[Args, Result]  # jitted
    gives: Layout
    mesh: Mesh

    def __call__(self, *args: Args.args, **kwargs: Args.kwargs) -> Result:
        return self.function(*args, **kwargs)

    def lower(self, *args: Any) -> tuple[jax.stages.Lowered, Any]:
        """Trace the program for arguments (or their shapes); also its results as shapes in their layouts."""
        lowered = self.function.lower(*args)  # type: ignore[attr-defined]
        results = lowered.out_info
        if isinstance(self.gives, P):
            return lowered, as_laid_out(results, self.gives, self.mesh)
        parts = zip(results, self.gives, strict=True)
        return lowered, tuple(as_laid_out(part, layout, self.mesh) for part, layout in parts)


def as_laid_out(tree: Any, layout: P, mesh: Mesh) -> Any:
    """The shapes of a tree of arrays, in a layout."""
    sharding = NamedSharding(mesh, layout)
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=sharding), tree)


class _Declared(Generic[Args, Result]):
    """A declared program: an attribute that builds a ``Program`` for its owner's mesh when it is first read."""

    def __init__(
        self,
        method: Callable[Concatenate[Any, Args], Result],
        takes: Layout | None,
        gives: Layout,
        options: Callable[[int], Options],
    ) -> None:
        self.method, self.takes, self.gives, self.options = method, takes, gives, options
        self.__doc__ = method.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, owner: None, kind: type) -> "_Declared[Args, Result]": ...
    @overload
    def __get__(self, owner: HasMesh, kind: type) -> Program[Args, Result]: ...
    def __get__(self, owner: HasMesh | None, kind: type) -> "_Declared[Args, Result] | Program[Args, Result]":
        if owner is None:
            return self
        program = self._build(owner)
        owner.__dict__[self.name] = program  # takes this attribute's place, so that it is built once
        return program

    def _build(self, owner: HasMesh) -> Program[Args, Result]:
        mesh, method = owner.mesh, self.method

        def function(*args: Args.args, **kwargs: Args.kwargs) -> Result:
            return method(owner, *args, **kwargs)

        function.__name__ = function.__qualname__ = self.name
        compiler_options = self.options(mesh.size)
        if self.takes is None:
            shardings = jax.tree.map(lambda layout: NamedSharding(mesh, layout), self.gives, is_leaf=_is_layout)
            jitted = jax.jit(function, out_shardings=shardings, compiler_options=compiler_options)
        else:
            # Brax does not trace with check_vma=True.
            sharded = jax.shard_map(function, mesh=mesh, in_specs=self.takes, out_specs=self.gives, check_vma=False)
            jitted = jax.jit(sharded, compiler_options=compiler_options)
        return Program(self.name, jitted, self.gives, mesh)


def _is_layout(x: Any) -> bool:
    return isinstance(x, P)


def no_options(num_devices: int) -> Options:
    """XLA's own defaults."""
    return None


def program(
    *, gives: Layout, takes: Layout | None = None, options: Callable[[int], Options] = no_options
) -> Callable[[Callable[Concatenate[Any, Args], Result]], _Declared[Args, Result]]:
    """Declare a method to be a program.

    ``takes`` None: the method is written for whole arrays, and XLA lays them out. Otherwise the method is written for
    one device's share of its arguments, laid out as ``takes``, and may exchange data over ``AXIS``. ``gives``: the
    layout of the results. ``options``: XLA's options by the number of devices (``qdil.devices.xla_options``).
    """
    return lambda method: _Declared(method, takes, gives, options)


def programs_of(owner: HasMesh) -> Iterator[str]:
    """The names of all programs that the class of ``owner`` declares."""
    return (name for name, value in vars(type(owner)).items() if isinstance(value, _Declared))
