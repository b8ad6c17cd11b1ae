"""A mapping that does not change, for the values that results are made of; it can be pickled and copied."""

from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

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
