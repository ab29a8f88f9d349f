"""Client side of RFC 2217 without a socket: any chunks, any server."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from drivebus.ports.rfc2217 import (
    BINARY,
    COM_PORT,
    DO,
    DONT,
    IAC,
    MAX_SUBNEGOTIATION_BYTES,
    SB,
    SE,
    WILL,
    WONT,
    TelnetClient,
    escape,
    subnegotiation,
)
from drivebus.serial_settings import SerialSettings

STREAM = (
    b"a\xff\xffb"
    + bytes((IAC, DO, COM_PORT, IAC, WILL, 1))
    + subnegotiation(101, (0xFF00FF00).to_bytes(4))
    + subnegotiation(106, b"\x04")
    + b"c\xff\xff"
)


def receive(chunks: list[bytes]) -> tuple[bytes, int, bytes, dict[int, bytes]]:
    client, data, line_errors, reply = TelnetClient(), b"", 0, b""
    client.start()
    for chunk in chunks:
        decoded = client.receive(chunk)
        data, line_errors, reply = data + decoded.data, line_errors + decoded.line_errors, reply + decoded.reply
    return data, line_errors, reply, client.acknowledged


def test_a_stream_is_decoded_at_every_split() -> None:
    expected = (b"a\xffbc\xff", 1, bytes((IAC, DONT, 1)), {1: b"\xff\x00\xff\x00"})
    assert receive([STREAM]) == expected
    assert receive([STREAM[i : i + 1] for i in range(len(STREAM))]) == expected
    for cut in range(len(STREAM)):
        assert receive([STREAM[:cut], STREAM[cut:]]) == expected


@given(st.binary())
def test_data_survives_escaping(data: bytes) -> None:
    assert receive([escape(data)])[:2] == (data, 0)


@given(st.lists(st.binary(max_size=40), max_size=20))
def test_no_server_bytes_raise_or_use_unbounded_memory(chunks: list[bytes]) -> None:
    client = TelnetClient()
    client.start()
    for chunk in chunks:
        client.receive(bytes((IAC,)) + chunk)
        assert len(client._sub or b"") <= MAX_SUBNEGOTIATION_BYTES
    assert len(client.acknowledged) <= 256


def test_an_endless_subnegotiation_is_discarded() -> None:
    client = TelnetClient()
    client.receive(bytes((IAC, SB, COM_PORT)) + b"x" * 10_000)
    assert client._sub is not None
    assert len(client._sub) == MAX_SUBNEGOTIATION_BYTES


def test_an_agreement_is_confirmed_only_once() -> None:
    """RFC 855: a change of state is replied to, its confirmation is not."""
    client = TelnetClient()
    client.start()
    assert client.receive(bytes((IAC, DO, COM_PORT))).reply == b""
    assert client.receive(bytes((IAC, DO, COM_PORT))).reply == b""
    assert client.receive(bytes((IAC, WILL, BINARY))).reply == b""
    assert client.receive(bytes((IAC, WILL, COM_PORT))).reply == bytes((IAC, DO, COM_PORT))
    assert client.receive(bytes((IAC, WILL, COM_PORT))).reply == b""
    assert client.receive(bytes((IAC, DONT, BINARY))).reply == b""
    assert client.receive(bytes((IAC, DONT, COM_PORT))).reply == bytes((IAC, WONT, COM_PORT))
    assert client.receive(bytes((IAC, DO, 24))).reply == bytes((IAC, WONT, 24))
    assert client.receive(bytes((IAC, WONT, 24))).reply == b""


def test_only_the_reply_to_our_own_option_shows_whether_the_server_supports_it() -> None:
    for verb, accepted in ((DO, True), (WILL, True), (DONT, False), (WONT, None)):
        client = TelnetClient()
        client.start()
        client.receive(bytes((IAC, verb, COM_PORT)))
        assert (client.accepted, client.is_telnet) == (accepted, True)


def test_serial_settings_use_the_numbers_of_rfc_2217_and_modem_lines_stay() -> None:
    sent = TelnetClient().configure(SerialSettings(19200, 8, "E", 2))
    for command, value in (
        (1, b"\x00\x00\x4b\x00"),
        (2, b"\x08"),
        (3, b"\x03"),
        (4, b"\x02"),
        (5, b"\x01"),
        (12, b"\x03"),
    ):
        assert bytes((IAC, SB, COM_PORT, command)) + value + bytes((IAC, SE)) in sent
    assert sent.count(bytes((IAC, SB, COM_PORT, 5))) == 1  # SET-CONTROL: flow control only, no RTS, no DTR
    odd = TelnetClient().configure(SerialSettings(0xFF00, 7, "O", 1))
    assert bytes((IAC, SB, COM_PORT, 1, 0, 0, 0xFF, 0xFF, 0, IAC, SE)) in odd
    assert bytes((IAC, SB, COM_PORT, 3, 2, IAC, SE)) in odd
