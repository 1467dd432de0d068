"""Loops of SX functions (`companion.core.control.rti.loops`) as one LLVM module."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from companion.core.control.rti.loops import Fetch, Kernel, Loop, Operand, Repeat, Step
from companion.jit.emit import Body, Value, translate

LINE = 64
"""Bytes of a cache line; x86-64 and aarch64."""


def module(entries: Mapping[str, Sequence[Step]]) -> str:
    """Text of a module with one function `void name(double *memory)` for each entry."""
    writer = _Writer()
    for name, steps in entries.items():
        writer.entry(name, steps)
    return "\n".join([*sorted(writer.intrinsics), *writer.functions]) + "\n"


@dataclass
class _Writer:
    functions: list[str] = field(default_factory=list)
    intrinsics: set[str] = field(default_factory=set)
    _kernels: dict[int, tuple[str, Kernel]] = field(default_factory=dict)
    _labels: int = 0

    def entry(self, name: str, steps: Sequence[Step]) -> None:
        lines = [f"define void @{name}(ptr noalias %memory) {{", "entry:"]
        before = "entry"
        self._steps(lines, steps, before)
        self.functions.append("\n".join([*lines, "  ret void", "}"]))

    def _steps(self, lines: list[str], steps: Sequence[Step], before: str) -> str:
        """Append the steps; label of the block in which they end."""
        for step in steps:
            match step:
                case Loop():
                    before = self._loop(lines, step, before)
                case Repeat():
                    before = self._repeat(lines, step, before)
                case Fetch():
                    before = self._fetch(lines, step, before)
        return before

    def _fetch(self, lines: list[str], fetch: Fetch, before: str) -> str:
        """Prefetch the functions up to `fetch.end`; LLVM keeps them in the order of the text."""
        n, end = self._label(), self._kernel(fetch.end)
        self.intrinsics.add("declare void @llvm.prefetch.p0(ptr, i32, i32, i32)")
        lines += [
            f"  %b{n} = ptrtoint ptr @kernel0 to i64",
            f"  %e{n} = ptrtoint ptr @{end} to i64",
            f"  br label %line{n}",
            f"line{n}:",
            f"  %a{n} = phi i64 [ %b{n}, %{before} ], [ %z{n}, %line{n} ]",
            f"  %p{n} = inttoptr i64 %a{n} to ptr",
            f"  call void @llvm.prefetch.p0(ptr %p{n}, i32 0, i32 2, i32 1)",
            f"  %z{n} = add i64 %a{n}, {LINE}",
            f"  %more{n} = icmp slt i64 %z{n}, %e{n}",
            f"  br i1 %more{n}, label %line{n}, label %fetched{n}",
            f"fetched{n}:",
        ]
        return f"fetched{n}"

    def _label(self) -> int:
        self._labels += 1
        return self._labels

    def _loop(self, lines: list[str], loop: Loop, before: str) -> str:
        n = self._label()
        lines += [
            f"  br label %loop{n}",
            f"loop{n}:",
            f"  %i{n} = phi i64 [ 0, %{before} ], [ %next{n}, %loop{n} ]",
            f"  %s{n} = mul i64 %i{n}, {loop.by}",
            f"  %f{n} = add i64 %s{n}, {loop.first}",
        ]
        k = f"%f{n}"
        if loop.last is not None:
            lines += [f"  %c{n} = icmp sgt i64 {k}, {loop.last}"]
            lines += [f"  %k{n} = select i1 %c{n}, i64 {loop.last}, i64 {k}"]
            k = f"%k{n}"
        lines += [f"  call void @{self._kernel(kernel)}(ptr %memory, i64 {k})" for kernel in loop.kernels]
        lines += [
            f"  %next{n} = add i64 %i{n}, 1",
            f"  %more{n} = icmp slt i64 %next{n}, {loop.count}",
            f"  br i1 %more{n}, label %loop{n}, label %done{n}",
            f"done{n}:",
        ]
        return f"done{n}"

    def _repeat(self, lines: list[str], repeat: Repeat, before: str) -> str:
        n = self._label()
        inner: list[str] = []
        end = self._steps(inner, repeat.body, f"again{n}")
        lines += [
            f"  br label %test{n}",
            f"test{n}:",
            f"  %t{n} = phi i64 [ 0, %{before} ], [ %u{n}, %{end} ]",
            f"  %p{n} = getelementptr double, ptr %memory, i64 {repeat.flag}",
            f"  %g{n} = load double, ptr %p{n}",
            f"  %open{n} = fcmp une double %g{n}, 0.0",
            f"  %few{n} = icmp slt i64 %t{n}, {repeat.most}",
            f"  %go{n} = and i1 %open{n}, %few{n}",
            f"  br i1 %go{n}, label %again{n}, label %settled{n}",
            f"again{n}:",
            *inner,
            f"  %u{n} = add i64 %t{n}, 1",
            f"  br label %test{n}",
            f"settled{n}:",
        ]
        return f"settled{n}"

    def _kernel(self, kernel: Kernel) -> str:
        if id(kernel) not in self._kernels:
            name = f"kernel{len(self._kernels)}"
            self._kernels[id(kernel)] = name, kernel
            self.functions.append(self._text(name, kernel))
        return self._kernels[id(kernel)][0]

    def _text(self, name: str, kernel: Kernel) -> str:
        """One kernel as a function of (memory, k). Inputs are loaded at first use, outputs stored at the end."""
        body = Body(kernel.width)
        bases = {}

        def place(operand: Operand, offset: int) -> str:
            key = (operand.base, operand.step)
            if key not in bases:
                offset_k = body.add(f"mul i64 %k, {operand.step}")
                first = body.add(f"add i64 {offset_k}, {operand.base}")
                bases[key] = body.add(f"getelementptr double, ptr %memory, i64 {first}")
            return body.add(f"getelementptr double, ptr {bases[key]}, i64 {offset}")

        def by_lane(operand: Operand, offset: int) -> Callable[[int], str]:
            return lambda i: place(operand, offset + i * (operand.lane or 0))

        def load(index: int, nonzero: int) -> Value:
            operand = kernel.inputs[index]
            offset, kind = operand.offsets[nonzero], body.type_of(True)
            if operand.lane is None or kernel.width == 1:
                return body.add(f"load double, ptr {place(operand, offset)}, align 8"), False
            if operand.lane == 1:
                return body.add(f"load {kind}, ptr {place(operand, offset)}, align 8"), True
            return body.gathered(by_lane(operand, offset))

        written: list[tuple[Operand, int, Value]] = []
        translate(kernel.function, body, load, lambda i, nz, v: written.append((kernel.outputs[i], nz, v)))
        for operand, nonzero, value in written:
            offset, kind = operand.offsets[nonzero], body.type_of(True)
            if operand.lane is None or kernel.width == 1:
                body.lines.append(f"  store double {value[0]}, ptr {place(operand, offset)}, align 8")
            elif operand.lane == 1:
                lane, pointer = body.spread(value), place(operand, offset)
                body.lines.append(f"  store {kind} {lane}, ptr {pointer}, align 8")
            else:
                body.scatter(value, by_lane(operand, offset))
        self.intrinsics |= body.intrinsics
        head = f"define internal void @{name}(ptr noalias %memory, i64 %k) {{"
        return "\n".join([head, *body.lines, "  ret void", "}"])
