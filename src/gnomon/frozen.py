"""Values that do not change: a mapping, and dataclasses that are made as fast as a start needs; both can be pickled.

A frozen dataclass of the standard library costs a millisecond to define, since seven of its methods are compiled, used
or not (Python 3.11), and a command defines hundreds. Of a value class, `__init__` is compiled when many are made, and
the other methods are shared.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, Field, FrozenInstanceError, dataclass, field, fields
from functools import cache
from typing import Any, TypeVar, dataclass_transform, overload

Key = TypeVar("Key")
Value_co = TypeVar("Value_co", covariant=True)


class FrozenMapping(Mapping[Key, Value_co]):
    """What a mapping holds now, in its order; unlike `types.MappingProxyType` it goes through pickle and `deepcopy`."""

    __slots__ = ("_held",)

    def __init__(self, held: Mapping[Key, Value_co]) -> None:
        self._held = dict(held)

    def __getitem__(self, key: Key) -> Value_co:
        return self._held[key]

    def __iter__(self) -> Iterator[Key]:
        return iter(self._held)

    def __len__(self) -> int:
        return len(self._held)

    def __or__(self, other: Mapping[Key, Any]) -> dict[Key, Any]:
        return {**self._held, **other}

    def __ror__(self, other: Mapping[Key, Any]) -> dict[Key, Any]:
        return {**other, **self._held}

    def __reversed__(self) -> Iterator[Key]:
        return reversed(self._held)

    def __repr__(self) -> str:
        return repr(self._held)

    def __reduce__(self) -> tuple[type, tuple[dict[Key, Any]]]:
        return type(self), (self._held,)


Class = TypeVar("Class", bound=type)
_MANY = 50  # of a class, from which on a compiled `__init__` is worth its time
_FEW = 4  # values, or fields of one, that are shown inside of another


@overload
def value_class(cls: Class, /) -> Class: ...
@overload
def value_class(*, eq: bool = False, kw_only: bool = True) -> Callable[[Class], Class]: ...
@dataclass_transform(frozen_default=True, kw_only_default=True, eq_default=False, field_specifiers=(field,))
def value_class(cls: Any = None, /, *, eq: bool = False, kw_only: bool = True) -> Any:
    """Return the class as a frozen dataclass with slots.

    Parameters
    ----------
    eq : whether values with the same fields are equal; else each is equal to itself alone
    kw_only : whether fields are given by name alone

    Examples
    --------
    >>> @value_class(eq=True)
    ... class Rate:
    ...     hz: float
    ...     unit: str = "Hz"
    >>> Rate(hz=2.0), Rate(hz=2.0) == Rate(hz=2.0)
    (Rate(hz=2.0, unit='Hz'), True)
    """
    if cls is None:
        return lambda given: _frozen(given, eq, kw_only)
    return _frozen(cls, eq, kw_only)


@cache
def field_names(cls: type) -> tuple[str, ...]:
    """Return the names of the fields of a value class."""
    return tuple(entry.name for entry in fields(cls))


def _frozen(cls: type, eq: bool, kw_only: bool) -> type:
    made: Any = dataclass(init=False, repr=False, eq=False, slots=True, kw_only=kw_only)(cls)
    uses = 0

    def __init__(self: Any, *placed: Any, **given: Any) -> None:  # noqa: N807
        nonlocal uses
        uses += 1
        if uses > _MANY or placed or not _set_fields(made, self, given):
            made.__init__ = _compiled_init(made)  # which says what is wrong with arguments
            made.__init__(self, *placed, **given)

    shared = {"__init__": __init__, "__repr__": _text, "__setattr__": _refuse, "__delattr__": _refuse}
    shared |= {"__getstate__": _state, "__setstate__": _with_state}
    shared |= {"__eq__": _equal, "__hash__": _hash} if eq else {}
    for name, method in shared.items():
        if name not in cls.__dict__ or cls.__dict__[name] is None:
            setattr(made, name, method)
    return made


@cache
def _setters(made: Any) -> tuple[tuple[str, Any, bool, Any, Any], ...]:
    return tuple(
        (entry.name, getattr(made, entry.name).__set__, entry.init, entry.default, entry.default_factory)
        for entry in fields(made)
    )


def _set_fields(made: Any, value: Any, given: Mapping[str, Any]) -> bool:
    """Set the fields of a value by their names; False where a name is missing, or unknown."""
    taken = 0
    for name, set_field, init, default, factory in _setters(made):
        if init and name in given:
            set_field(value, given[name])
            taken += 1
        elif factory is not MISSING:
            set_field(value, factory())
        elif default is not MISSING:
            set_field(value, default)
        elif init:
            return False
    if taken < len(given):
        return False
    if hasattr(made, "__post_init__"):
        value.__post_init__()
    return True


def _compiled_init(made: Any) -> Any:
    """Return what sets the fields of a class, as the standard library's would."""
    names: dict[str, Any] = {"_unset": MISSING}
    parameters, by_name, body = list[str](), list[str](), list[str]()
    for entry in fields(made):
        value, factory = f"_value_{entry.name}", f"_factory_{entry.name}"
        names |= {value: entry.default, factory: entry.default_factory}
        made_anew = entry.default_factory is not MISSING
        if entry.init:
            default = "=_unset" if made_anew else "" if entry.default is MISSING else f"={value}"
            (by_name if entry.kw_only else parameters).append(f"{entry.name}{default}")
            given = f"{factory}() if {entry.name} is _unset else {entry.name}" if made_anew else entry.name
        elif made_anew or entry.default is not MISSING:
            given = f"{factory}()" if made_anew else value
        else:
            continue
        names[f"_set_{entry.name}"] = getattr(made, entry.name).__set__  # of its slot
        body.append(f" _set_{entry.name}(self, {given})")
    if hasattr(made, "__post_init__"):
        body.append(" self.__post_init__()")
    head = ", ".join(["self", *parameters, *(["*", *by_name] if by_name else [])])
    exec("\n".join([f"def __init__({head}):", *body, " return None"]), names)
    return names["__init__"]


def _values(value: Any, chosen: Callable[[Field[Any]], bool] = lambda _: True) -> tuple[Any, ...]:
    return tuple(getattr(value, entry.name) for entry in fields(value) if chosen(entry))


def _text(self: Any) -> str:
    shown = (f"{entry.name}={_short(getattr(self, entry.name))}" for entry in fields(self) if entry.repr)
    return f"{type(self).__qualname__}({', '.join(shown)})"


def _short(value: Any) -> str:
    """Return a value inside of another as short as a line bears."""
    kind: type = type(value)
    if kind.__repr__ is _text and len(fields(kind)) > _FEW:
        return f"{kind.__qualname__}(...)"
    if hasattr(kind, "dtype"):
        return repr(value) if value.size <= _FEW else f"array{tuple(value.shape)}"
    if isinstance(value, Mapping):
        held: Mapping[Any, Any] = value
        return "{" + ", ".join(f"{key!r}: {_short(one)}" for key, one in held.items()) + "}"
    if isinstance(value, tuple):
        items: tuple[Any, ...] = value
        return repr(items) if len(items) <= _FEW else f"({len(items)} of {type(items[0]).__qualname__})"
    return repr(value)


def _equal(self: Any, other: Any) -> bool:
    if type(self) is not type(other):
        return NotImplemented
    return _values(self, lambda entry: entry.compare) == _values(other, lambda entry: entry.compare)


def _hash(self: Any) -> int:
    return hash(_values(self, lambda entry: entry.compare))


def _refuse(self: Any, name: str, _value: Any = None) -> None:
    raise FrozenInstanceError(f"cannot change field {name!r} of a {type(self).__name__}")


def _state(self: Any) -> tuple[Any, ...]:
    return _values(self)


def _with_state(self: Any, state: tuple[Any, ...]) -> None:
    for entry, value in zip(fields(self), state, strict=True):
        object.__setattr__(self, entry.name, value)
