"""Loops of kernels (`Kernel`, `Loop`, `Repeat`) as source text; what the emitter writes in LLVM's language."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from companion.core.control.rti.loops import Kernel, Loop, Operand, Repeat, Step
from sim.studies.machine_code.source import C_HEAD, PYTHON, PYTHON_HEAD, C, Language, walk

JIT = '@njit(cache=True, fastmath={"contract"}, error_model="numpy")\n'


class Writer:
    """Source of a module with a function of (m, the memory) for each entry."""

    def __init__(self, to: Language):
        self._to, self._python = to, to is PYTHON
        self._functions: list[str] = []
        self._kernels: dict[int, tuple[str, Kernel]] = {}

    def module(self, entries: Mapping[str, Sequence[Step]]) -> str:
        """All of it."""
        for name, steps in entries.items():
            lines = self._steps(steps, 1)
            self._functions.append(self._function(name, lines, entry=True))
        return (PYTHON_HEAD if self._python else C_HEAD) + "\n".join(self._functions)

    def _function(self, name: str, lines: list[str], *, entry: bool) -> str:
        if self._python:
            return f"{JIT}def {name}(m{'' if entry else ', k'}):\n" + "\n".join([*lines, "    return"]) + "\n"
        kind, more = ("void", "") if entry else ("static void __attribute__((noinline))", ", long k")
        return f"{kind} {name}(double *restrict m{more}) {{\n" + "\n".join(lines) + "\n}\n"

    def _loop(self, i: str, n: int, lines: list[str], depth: int) -> list[str]:
        return ["    " * depth + self._to.loop.format(i=i, n=n), *lines, "    " * depth + self._to.end]

    def _steps(self, steps: Sequence[Step], depth: int) -> list[str]:
        lines: list[str] = []
        for step in steps:
            if isinstance(step, Loop):
                lines += self._loop(f"i{depth}", step.count, self._calls(step, depth), depth)
            elif isinstance(step, Repeat):
                end = "break" if self._python else "break;"
                test = f"if m[{step.flag}] == 0.0: {end}" if self._python else f"if (m[{step.flag}] == 0.0) {end}"
                lines += self._loop(
                    f"t{depth}", step.most, ["    " * (depth + 1) + test, *self._steps(step.body, depth + 1)], depth
                )
        return lines

    def _calls(self, loop: Loop, depth: int) -> list[str]:
        k = f"{loop.first} + {loop.by} * i{depth}"
        if loop.last is not None:
            k = f"min({k}, {loop.last})" if self._python else self._to.chosen(f"{k} > {loop.last}", str(loop.last), k)
        end = "" if self._python else ";"
        return [f"{'    ' * (depth + 1)}{self._kernel(kernel)}(m, {k}){end}" for kernel in loop.kernels]

    def _kernel(self, kernel: Kernel) -> str:
        if id(kernel) not in self._kernels:
            name = f"kernel{len(self._kernels)}"
            self._kernels[id(kernel)] = name, kernel
            self._functions.append(self._text(name, kernel))
        return self._kernels[id(kernel)][0]

    def _text(self, name: str, kernel: Kernel) -> str:
        bases: dict[tuple[int, int], str] = {}
        head: list[str] = []

        def place(operand: Operand, nonzero: int) -> tuple[str, bool]:
            key = operand.base, operand.step
            if key not in bases:
                bases[key] = f"b{len(bases)}"
                text = f"uint64(k * {key[1]} + {key[0]})" if self._python else f"k * {key[1]} + {key[0]}"
                head.append(f"{bases[key]} = {text}" if self._python else f"const long {bases[key]} = {text};")
            offset, lane = operand.offsets[nonzero], operand.lane if kernel.width > 1 else None
            if not self._python:
                return f"m[{bases[key]} + {offset}{f' + {lane} * l' if lane else ''}]", lane is not None
            index = f"{bases[key]} + uint64({offset})" if offset else bases[key]
            return f"m[{index}{f' + uint64({lane}) * uint64(l)' if lane else ''}]", lane is not None

        outer, inner, out = walk(self._to, kernel.function, lambda i, nonzero: place(kernel.inputs[i], nonzero))
        end = "" if self._python else ";"
        for (i, nonzero), value in out.items():
            where, varies = place(kernel.outputs[i], nonzero)
            (inner if varies else outer).append(f"{where} = {value}{end}")
        indented = ["        " + line for line in inner]
        loop = self._loop("l", kernel.width, indented, 1) if indented else []
        if loop and not self._python:
            loop = ["#pragma GCC ivdep", *loop]
        return self._function(name, ["    " + line for line in (*head, *outer)] + loop, entry=False)


def python(entries: Mapping[str, Sequence[Step]]) -> str:
    """For numba."""
    return Writer(PYTHON).module(entries)


def c(entries: Mapping[str, Sequence[Step]]) -> str:
    """For a C compiler."""
    return Writer(C).module(entries)
