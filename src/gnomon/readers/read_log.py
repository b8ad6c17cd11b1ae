"""What was stated by the user and what was read so far, while a recording of several files is put together."""

from dataclasses import dataclass, field

from ..recording import Source
from ..units import Units


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadLog:
    """What was stated, and lists that grow: the files, and sentences on what was assumed.

    Attributes
    ----------
    units : of what is read
    cameras_alone : whether IMUs are passed over; images may be numbered then, where nothing says when they were taken
    """

    units: Units
    cameras_alone: bool = False
    sources: list[Source] = field(default_factory=list[Source])
    notes: list[str] = field(default_factory=list[str])

    def note(self, text: str) -> None:
        """Keep a sentence, once."""
        if text not in self.notes:
            self.notes.append(text)
