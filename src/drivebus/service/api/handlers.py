"""Binding of handlers to the operations that they answer."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from inspect import isfunction, ismodule
from typing import Any, TypeVar

from drivebus.service.api.operations import Operation

Handler = TypeVar("Handler", bound=Callable[..., Awaitable[Any]])
HANDLERS: dict[str, Callable[..., Awaitable[Any]]] = {}
"""Handler of each operation by its name: a method of an object of the service, or a function of a gateway."""


def handles(operation: Operation) -> Callable[[Handler], Handler]:
    """Return a decorator for the handler of ``operation``. Raises ValueError where it has one already."""

    def bind(handler: Handler) -> Handler:
        if operation.name in HANDLERS:
            raise ValueError(f"{operation.name} has two handlers")
        HANDLERS[operation.name] = handler
        return handler

    return bind


def bound_handlers(objects: Iterable[object]) -> dict[str, Callable[..., Awaitable[Any]]]:
    """Return the handlers that ``objects`` have, by the names of their operations.

    They are methods, bound to their object, and functions of modules.
    """
    names = {handler: name for name, handler in HANDLERS.items()}
    return {
        names[function]: function if ismodule(owner) else function.__get__(owner)
        for owner in objects
        for function in vars(owner if ismodule(owner) else type(owner)).values()
        if isfunction(function) and function in names
    }
