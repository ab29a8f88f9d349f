"""What every harness of this folder does: bytes chosen by atheris go into one decoder, and its promises are looked at.

    python tests/fuzz/fuzz_dzb100.py -runs=100000        (pip install atheris; Linux)

The first byte of an input chooses the decoder (a request at a station, or the reply to one of the worked requests) and
whether the rest is given its proper check, without which no bytes would come past it. The promises are those of
``message.Codec``: no error but ProtocolError, whole and byte by byte alike, and ``need`` and ``size`` that hold.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Codec, Complete, CompleteIfSilent, DecodeResult, Incomplete

MAX_INPUT_LENGTH = 300
"""Bytes of an input that are looked at: each is fed byte by byte, so time grows with the square."""
SEALED_CHOICE = 0x80
FuzzedDecoder = Callable[[bytes], DecodeResult]


class BrokenPromise(AssertionError):
    """A decoder breaks a promise."""


@dataclass(frozen=True, slots=True)
class AtherisTarget:
    """One encoding: its codec, the requests whose replies are tried, and how a frame is given its check."""

    codec: Codec
    requests: Sequence[Any]
    seal: Callable[[bytes], bytes]
    frames: Sequence[bytes]
    """Worked frames: where the search begins."""

    def decoder(self, choice: int) -> FuzzedDecoder:
        """0 is the station's side; the others are the host's, one for each request."""
        chosen = choice % (len(self.requests) + 1)
        if chosen == 0:
            return self.codec.decode_request
        request = self.requests[chosen - 1]
        return lambda data: self.codec.decode_reply(request, data)

    def run_input(self, given: bytes) -> None:
        """Raises Broken, or whatever else came out of the decoder."""
        if given:
            body = given[1 : MAX_INPUT_LENGTH + 1]
            check_decoder(
                self.decoder(given[0] & ~SEALED_CHOICE), self.seal(body) if given[0] & SEALED_CHOICE else body
            )

    def seeds(self) -> list[bytes]:
        """Every worked frame for every decoder."""
        return [bytes((choice,)) + frame for choice in range(len(self.requests) + 1) for frame in self.frames]


def check_decoder(decode: FuzzedDecoder, data: bytes) -> None:
    """Raises Broken unless the decoder keeps its promises for these bytes."""
    whole, need = _decode_outcome(decode, data), 1
    found: object = None
    for end in range(len(data) + 1):
        found = _decode_outcome(decode, data[:end])
        _check_sizes(found, data[:end], need)
        if not isinstance(found, Incomplete | CompleteIfSilent):
            break
        need = max(need, found.need)
    if found != whole:
        raise BrokenPromise(f"{data.hex(' ')}: whole {whole}, byte by byte {found}")


def _decode_outcome(decode: FuzzedDecoder, data: bytes) -> object:
    try:
        return decode(data)
    except ProtocolError as error:
        if not 0 <= error.size <= len(data):
            raise BrokenPromise(f"{data.hex(' ')}: size {error.size} of a refused frame") from error
        str(error)
        return type(error), error.key, error.size


def _check_sizes(found: object, data: bytes, need: int) -> None:
    """``need`` is what was asked for before: with less nothing may be complete."""
    if isinstance(found, Complete | CompleteIfSilent) and not 0 < found.size <= len(data):
        raise BrokenPromise(f"{data.hex(' ')}: {found} is longer than what is there")
    if isinstance(found, Complete) and len(data) < need:
        raise BrokenPromise(f"{data.hex(' ')}: complete, but {need} bytes were asked for")
    if isinstance(found, Incomplete | CompleteIfSilent) and found.need <= len(data):
        raise BrokenPromise(f"{data.hex(' ')}: {found} asks for what is there")


def main(name: str) -> None:
    """Let atheris choose the inputs; libFuzzer's options are those of the command line."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    import atheris  # type: ignore[import-not-found]

    for loaded in [one for one in sys.modules if one.startswith("drivebus")]:
        del sys.modules[loaded]
    with atheris.instrument_imports(include=["drivebus.protocols"], enable_loader_override=False):
        from fuzz.targets import ATHERIS_TARGETS
    target = ATHERIS_TARGETS[name]
    with tempfile.TemporaryDirectory() as folder:
        for number, seed in enumerate(target.seeds()):
            Path(folder, str(number)).write_bytes(seed)
        options = [sys.argv[0], f"-max_len={MAX_INPUT_LENGTH}", "-timeout=10", *sys.argv[1:], folder]
        atheris.Setup(options, target.run_input)
        atheris.Fuzz()
