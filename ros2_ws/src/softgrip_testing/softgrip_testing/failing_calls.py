# SPDX-License-Identifier: Apache-2.0
"""Look at each call that stands in a module, and let one fail: the code is compiled with a look before every call.

`sys.setprofile` would see them without that, but now and then CPython 3.11 dies of a segmentation fault under it where
PyYAML's Cython calls back (known: cython/cython#5222).
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType, TracebackType
from typing import Any, TypeVar

#: Gets a file, a line and the name of what is called there; what it raises, the call raises.
Look = Callable[[str, int, str], None]
T = TypeVar("T")

_CALL = "_looked_at_call"
_BLOCK = "_looked_at_block"


@contextmanager
def looking_at_calls(modules: list[ModuleType], look: Look) -> Iterator[None]:
    """Call ``look`` before each call that stands in a function of the modules, as long as the block lasts.

    The beginning and the end of a ``with`` are calls too, ``__enter__`` and ``__exit__``. A look at an end,
    ``__exit__`` or ``close``, comes after it: what is closed is closed whatever is answered (close(2)). Not looked at:
    operators, properties, ``super()``, and what runs once at import.

    Args:
        modules: imported from files of Python.
        look: called on the thread that calls.
    """
    changed: list[tuple[FunctionType, CodeType]] = []
    try:
        for module in modules:
            file = str(module.__file__)
            vars(module)[_CALL] = _calls(file, look)
            vars(module)[_BLOCK] = _blocks(file, look)
            compiled = _compiled(file)
            for function in _functions(module):
                code = compiled[function.__code__.co_qualname]
                changed.append((function, function.__code__))
                function.__code__ = code
        yield
    finally:
        for function, code in changed:
            function.__code__ = code
        for module in modules:
            vars(module).pop(_CALL, None)
            vars(module).pop(_BLOCK, None)


def _calls(file: str, look: Look) -> Callable[..., Any]:
    def call(line: int, name: str, called: Callable[..., T], /, *arguments: Any, **options: Any) -> T:
        if name != "close":
            look(file, line, name)
        answer = called(*arguments, **options)
        if name == "close":
            look(file, line, name)
        return answer

    return call


def _blocks(file: str, look: Look) -> Callable[[int, Any], Any]:
    class Block:
        def __init__(self, line: int, manager: Any) -> None:
            self._line, self._manager = line, manager

        def __enter__(self) -> Any:
            look(file, self._line, "__enter__")
            return self._manager.__enter__()

        def __exit__(
            self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
        ) -> bool | None:
            held: bool | None = self._manager.__exit__(kind, error, trace)
            look(file, self._line, "__exit__")
            return held

    return Block


class CallRewriter(ast.NodeTransformer):
    """Turns ``called(…)`` into ``_CALL(line, name, called, …)`` and ``with x`` into ``with _BLOCK(line, x)``."""

    def visit_Call(self, node: ast.Call) -> ast.expr:
        """Look before a call, after its arguments."""
        self.generic_visit(node)
        if isinstance(node.func, ast.Name) and node.func.id == "super":  # looks at its caller's first argument
            return node
        name = node.func.attr if isinstance(node.func, ast.Attribute) else ast.unparse(node.func)
        return self._call(_CALL, node, [ast.Constant(name), node.func, *node.args], node.keywords)

    def visit_withitem(self, node: ast.withitem) -> ast.withitem:
        """Look at the beginning and the end of a block."""
        where = node.context_expr
        self.generic_visit(node)
        node.context_expr = self._call(_BLOCK, where, [node.context_expr], [])
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.ClassDef:
        """Leave out decorators and bases: they run once, at import."""
        node.body = [self.visit(part) for part in node.body]
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        """Leave out decorators and defaults, as of a class."""
        node.body = [self.visit(part) for part in node.body]
        return node

    @staticmethod
    def _call(name: str, where: ast.expr, arguments: list[ast.expr], options: list[ast.keyword]) -> ast.Call:
        called = ast.Call(ast.Name(name, ast.Load()), [ast.Constant(where.lineno), *arguments], options)
        return ast.fix_missing_locations(ast.copy_location(called, where))


@lru_cache(maxsize=32)
def _compiled(file: str) -> dict[str, CodeType]:
    """Code with looks of every function of a file, by qualified name."""
    module = compile(CallRewriter().visit(ast.parse(Path(file).read_bytes(), file)), file, "exec", dont_inherit=True)
    found: dict[str, CodeType] = {}
    waiting = [module]
    while waiting:
        code = waiting.pop()
        found[code.co_qualname] = code
        waiting += [part for part in code.co_consts if isinstance(part, CodeType)]
    return found


def _functions(module: ModuleType) -> Iterator[FunctionType]:
    """Give all functions and methods that stand in a module's file."""
    waiting = list(vars(module).values())
    while waiting:
        value = waiting.pop()
        if inspect.isclass(value) and value.__module__ == module.__name__:
            waiting += vars(value).values()
            continue
        if isinstance(value, property):
            waiting += [value.fget, value.fset]
        value = getattr(value, "__func__", value)  # of a static or a class method
        if callable(value):
            value = inspect.unwrap(value)
        if isinstance(value, FunctionType) and value.__code__.co_filename == module.__file__:
            yield value
