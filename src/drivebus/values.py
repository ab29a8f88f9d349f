"""Values of a drive: readings with their quality, the scaling of 16-bit words to quantities, and texts by language."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Literal

from drivebus.i18n import LANGUAGES, ListParts, join, text

Coding = Literal["binary", "signed", "bcd"]


@dataclass(frozen=True, slots=True)
class Text:
    """Text in English, Chinese and further languages; as a parameter of a message, ``i18n.text`` picks the language."""

    en: str
    zh: str
    others: tuple[tuple[str, str], ...] = ()
    """Code and text of each further language."""

    @classmethod
    def from_mapping(cls, by_language: Mapping[str, str]) -> Text:
        """Return the text of a mapping from language to text; its first text replaces a missing one of en or zh.

        Raises ValueError for an empty mapping.
        """
        if not by_language:
            raise ValueError("a text needs one language at least")
        others = tuple((language, text) for language, text in by_language.items() if language not in ("en", "zh"))
        first = next(iter(by_language.values()))
        en = by_language.get("en") or by_language.get("zh") or first
        return cls(en, by_language.get("zh") or en, others)

    @classmethod
    def per_language(cls, make: Callable[[str], str]) -> Text:
        """Return the text that ``make`` returns for the code of each language of the catalogues."""
        return cls.from_mapping({language: make(language) for language in LANGUAGES})

    @classmethod
    def join(cls, texts: Sequence[Text], kind: ListParts) -> Text:
        """Return a list of texts as one text, in the languages of the catalogues and of each of them."""
        languages = dict.fromkeys((*LANGUAGES, *(language for text in texts for language, _ in text.others)))
        return cls.from_mapping(
            {language: join((text.in_language(language) for text in texts), kind, language) for language in languages}
        )

    @classmethod
    def join_names(cls, names: Iterable[str]) -> Text:
        """Return names, which are the same in every language, as one list."""
        return cls.join([cls(name, name) for name in names], "items")

    def by_language(self) -> dict[str, str]:
        """Return the texts by the code of their language."""
        return {"en": self.en, "zh": self.zh, **dict(self.others)}

    def in_language(self, language: str) -> str:
        """Return the text in a language, in English where it has none."""
        return self.by_language().get(language, self.en)

    def replace(self, old: str, new: str) -> Text:
        """Return the text with a part replaced in every language."""
        return Text.from_mapping({language: text.replace(old, new) for language, text in self.by_language().items()})


def bilingual_text(key: str, /, **params: Any) -> Text:
    """Return a text of the catalogues in their languages."""
    return Text.per_language(lambda language: text(key, language, **params))


class Quality(StrEnum):
    """Quality of a reading: good, uncertain or bad; ``reason`` of the reading gives the cause."""

    GOOD = "good"
    UNCERTAIN = "uncertain"
    BAD = "bad"


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """A value with its unit, quality and the monotonic second at which its request was answered.

    ``value`` is None where the drive does not report it; ``reason`` (a message key) then gives the cause. A missing
    value is never 0.0.
    """

    value: float | int | str | None
    unit: str = ""
    quality: Quality = Quality.GOOD
    source_time: float | None = None
    reason: str | None = None
    raw: int | None = None

    def age_s(self, now: float) -> float | None:
        """Return the seconds since the value was true on the drive, None if it was never read."""
        return None if self.source_time is None else max(0.0, now - self.source_time)


def missing_reading(reason: str, unit: str = "") -> Reading:
    """Return a reading without a value; ``reason`` is a message key."""
    return Reading(value=None, unit=unit, quality=Quality.BAD, reason=reason)


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale of a raw number: value = raw × factor + offset."""

    factor: float = 1.0
    offset: float = 0.0
    coding: Coding = "binary"
    decimals: int = 0
    """Places that the drive's own display shows."""
    words: int = 1
    """Registers of the number, 16 bits each."""

    def value(self, raw: int) -> float:
        """Return the quantity of a raw number. Raises ValueError for a BCD word with a digit above 9."""
        return round(self._number(raw) * self.factor + self.offset, self.decimals + 3)

    def raw(self, value: float) -> int:
        """Return the nearest raw number. Raises ValueError where it does not fit its words."""
        number = round((value - self.offset) / self.factor)
        modulus = 1 << 16 * self.words
        lowest, end = {"signed": (-modulus // 2, modulus // 2), "bcd": (0, 10000)}.get(self.coding, (0, modulus))
        if not lowest <= number < end:
            raise ValueError(f"{value} does not fit {16 * self.words} bits at a step of {self.factor}")
        return int(str(number), 16) if self.coding == "bcd" else number % modulus

    def _number(self, raw: int) -> int:
        modulus = 1 << 16 * self.words
        if self.coding == "signed" and raw >= modulus // 2:
            return raw - modulus
        if self.coding == "bcd":
            digits = f"{raw:X}"
            if not digits.isdecimal():
                raise ValueError(f"word {raw:04X}H is no decimal number")
            return int(digits)
        return raw
