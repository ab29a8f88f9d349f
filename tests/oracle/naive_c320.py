"""C320, read a second time: slow, plain, and sharing no line with ``drivebus``. Section numbers are the manual's.

Not in the manual's words but deduced from its frames: hex fields are packed to the right although 4.5 and 4.6 print
nibbles, and ASCII digits above 9 are the letters A to F although 4.5 prints 3AH. Not in the manual at all: whether a
class-0 reply loses its digits 7 and 8 in a fault. Here they are absent then.
"""

# 2.4.2: 0 to 30, 31 is everybody.
BROADCAST = 31

# 2.4.3: length of what the master sends, section 3 (1) to (5).
REQUEST_LENGTH = {0: 14, 1: 14, 2: 14, 3: 18, 4: 15, 5: 18}

# 2.4.4, without the reserved 30H and 31H.
OPERATIONS = {
    0x00: "none",
    0x01: "run forward",
    0x02: "run reverse",
    0x03: "stop",
    0x04: "jog forward",
    0x05: "jog reverse",
    0x06: "jog stop",
    0x10: "set frequency",
    0x11: "run forward with frequency",
    0x12: "run reverse with frequency",
    0x13: "stop with frequency",
    0x14: "jog forward with frequency",
    0x15: "jog reverse with frequency",
    0x16: "jog stop with frequency",
    0x20: "fault reset",
    0x21: "emergency stop",
}

# 2.4.5, without the reserved 5 and 9 to F.
RESPONSES = {
    0: "ok",
    1: "value out of range",
    2: "not while running",
    3: "password",
    4: "reserved or hidden parameter",
    6: "bad code or address",
    7: "illegal ascii character",
    8: "illegal class or operation",
}
SHORT_RESPONSES = [6, 7, 8]

# 2.4.6, without the reserved 06H and 10H.
STATES = {
    0x00: "dc bus not ready",
    0x01: "running forward",
    0x02: "running reverse",
    0x03: "stopped",
    0x04: "jogging forward",
    0x05: "jogging reverse",
    0x11: "accelerating forward",
    0x12: "accelerating reverse",
    0x13: "restarting after a short stop",
    0x14: "decelerating forward",
    0x15: "decelerating reverse",
    0x16: "dc braking",
    0x20: "fault",
    0x21: "emergency stop",
}

ASCII_DIGITS = "0123456789ABCDEF"


def write_field(encoding, digits, number):
    """A field of so many digits. ASCII: one character each. Hex: packed to the right, zeros before it (2.3 (2))."""
    if encoding == "ascii":
        text = ""
        for place in range(digits - 1, -1, -1):
            text = text + ASCII_DIGITS[(number // 16**place) % 16]
        return [ord(letter) for letter in text]
    if digits == 1:
        return [number]
    if digits == 2:
        return [0, number]
    return [0, 0, number // 256, number % 256]


def checksum(fields):
    """2.4.7: the sum of the bytes from the slave's address to the data; four digits hold 16 bits of it."""
    total = 0
    for byte in fields:
        total = total + byte
    return total % 65536


def build(encoding, address, kind, operation=0, group=0, item=0, data=0):
    """The bytes of a request; ValueError for what the manual does not define."""
    if not 0 <= address <= 31:
        raise ValueError("2.4.2: address")
    if kind not in REQUEST_LENGTH:
        raise ValueError("2.4.3: class 6 to F is reserved")
    if operation not in OPERATIONS:
        raise ValueError("2.4.4: operation")
    if not 0 <= group <= 15 or not 0 <= item <= 255 or not 0 <= data <= 65535:
        raise ValueError("2.3: a digit too many")
    if kind == 0 and item != 0:
        raise ValueError("3 (1): digits 7 and 8 are 0; 4 to F of digit 6 are reserved, but listed with an answer")
    if kind in (1, 4) and group != 0:
        raise ValueError("3 (2), (5): digit 6 of class 1 is 0, class 4 has none")
    if kind == 4 and item != 0:
        raise ValueError("3 (5): class 4 has no item")
    if kind in (0, 1, 2) and data != 0:
        raise ValueError("3 (1) to (3): no data")
    fields = write_field(encoding, 2, address)
    fields = fields + write_field(encoding, 1, kind)
    fields = fields + write_field(encoding, 2, operation)
    if kind != 4:
        fields = fields + write_field(encoding, 1, group)
        fields = fields + write_field(encoding, 2, item)
    if kind in (3, 4, 5):
        fields = fields + write_field(encoding, 4, data)
    frame = seal(encoding, fields)
    assert len(frame) == REQUEST_LENGTH[kind]
    return frame


def seal(encoding, fields):
    """2.4.1, 2.4.7, 2.4.8: header, fields, sum, end."""
    if encoding == "ascii":
        head = 0x2A
    else:
        head = 0x5A
    return bytes([head] + list(fields) + write_field(encoding, 4, checksum(fields)) + [0x0D])


def read_field(encoding, part):
    """The number in a field's bytes, or None where a byte can't stand there."""
    if encoding == "ascii":
        number = 0
        for byte in part:
            if chr(byte) not in ASCII_DIGITS:
                return None
            number = number * 16 + ASCII_DIGITS.index(chr(byte))
        return number
    if len(part) == 1:
        if part[0] > 0x0F:
            return None
        return part[0]
    if len(part) == 2:
        if part[0] != 0:
            return None
        return part[1]
    if part[0] != 0 or part[1] != 0:
        return None
    return part[2] * 256 + part[3]


def read_request(request):
    """A request of ours as a dict. It is our own: only the places are looked up, nothing is judged."""
    if request[0] == 0x2A:
        encoding = "ascii"
    else:
        encoding = "hex"
    asked = {
        "encoding": encoding,
        "address": read_field(encoding, request[1:3]),
        "kind": read_field(encoding, request[3:4]),
        "operation": read_field(encoding, request[4:6]),
    }
    if asked["kind"] == 4:
        asked["data"] = read_field(encoding, request[6:10])
        return asked
    asked["group"] = read_field(encoding, request[6:7])
    asked["item"] = read_field(encoding, request[7:9])
    if asked["kind"] in (3, 5):
        asked["data"] = read_field(encoding, request[9:13])
    return asked


def judge(request, reply):
    """What the reply to this request means, as a dict, or "refuse"."""
    asked = read_request(request)
    encoding = asked["encoding"]
    if asked["address"] == BROADCAST:
        return "refuse"  # 2.2: nobody answers a broadcast
    if len(reply) not in (11, 18):
        return "refuse"  # 2.4.5 and section 3: no other length exists
    if reply[0] != request[0]:
        return "refuse"  # 2.4.1, and every example of section 4 answers in the request's own alphabet
    if reply[-1] != 0x0D:
        return "refuse"  # 2.4.8
    if read_field(encoding, reply[-5:-1]) != checksum(reply[1:-5]):
        return "refuse"  # 2.4.7
    if read_field(encoding, reply[1:3]) != asked["address"]:
        return "refuse"  # 2.4.2
    response = read_field(encoding, reply[3:4])
    if response not in RESPONSES:
        return "refuse"  # 2.4.5: 5 and 9 to F are reserved
    if response == 7 and encoding == "hex":
        return "refuse"  # 2.4.5: "where data is sent in ASCII"
    if (response in SHORT_RESPONSES) != (len(reply) == 11):
        return "refuse"  # 2.4.5: 11 bytes with 6 to 8, else 18
    if len(reply) == 11:
        return judge_short(encoding, asked, response, reply)
    return judge_full(encoding, asked, response, reply)


def judge_short(encoding, asked, response, reply):
    """2.4.5: after the response come two zeros and the checksum."""
    if read_field(encoding, reply[4:6]) != 0:
        return "refuse"
    return {"address": asked["address"], "response": response}


def judge_full(encoding, asked, response, reply):
    """2.3.2."""
    state = read_field(encoding, reply[4:6])
    group = read_field(encoding, reply[6:7])
    data = read_field(encoding, reply[9:13])
    if state not in STATES or group is None or data is None:
        return "refuse"  # 2.4.6: 06H and 10H are reserved
    meaning = {"address": asked["address"], "response": response, "state": state, "group": group}
    if asked["kind"] == 0:
        return judge_identity(encoding, asked, reply, meaning, data)
    item = read_field(encoding, reply[7:9])
    if item is None:
        return "refuse"
    if asked["kind"] == 4:
        expected_group = 0  # 3 (5)
        expected_item = None  # F6.12 chooses it
    else:
        expected_group = asked["group"]  # 3 (2) to (4)
        expected_item = asked["item"]
    if group != expected_group:
        return "refuse"
    if state == 0x20:
        meaning["fault_code"] = item  # 2.4.6: digits 7 and 8 are the fault code
    elif expected_item is not None and item != expected_item:
        return "refuse"
    else:
        meaning["item"] = item
    if asked["kind"] in (3, 5):
        if response == 0 and data != asked["data"]:
            return "refuse"  # 3 (4): digits 9 to 12 are the data that was set
        if response != 0 and data != 0:
            return "refuse"  # 3 (4), note: 0000 where the order can't be carried out
    meaning["data"] = data
    return meaning


def judge_identity(encoding, asked, reply, meaning, data):
    """3 (1): digits 7 and 8 are two single digits (4.1 in hex: ``04 00``, not ``00 40``), 9 to 12 a number."""
    if meaning["group"] != asked["group"]:
        return "refuse"
    digit_7 = read_field(encoding, reply[7:8])
    digit_8 = read_field(encoding, reply[8:9])
    both = read_field(encoding, reply[7:9])
    if meaning["state"] == 0x20 and both is not None:
        meaning["data"] = data  # 2.4.6: digits 7 and 8 may be the fault code, a number of two digits: neither is told
        return meaning
    if digit_7 is None or digit_8 is None:
        return "refuse"
    if meaning["state"] != 0x20:
        meaning["digit_7"] = digit_7
        meaning["digit_8"] = digit_8
    meaning["data"] = data
    return meaning


def build_reply(encoding, address, response, state, group, item, data):
    """2.3.2: what a drive sends. Nothing is judged, so that reserved numbers can be sent too."""
    fields = write_field(encoding, 2, address)
    fields = fields + write_field(encoding, 1, response)
    fields = fields + write_field(encoding, 2, state)
    if response not in SHORT_RESPONSES:
        fields = fields + write_field(encoding, 1, group)
        fields = fields + write_field(encoding, 2, item)
        fields = fields + write_field(encoding, 4, data)
    return seal(encoding, fields)


def build_identity(encoding, address, response, state, group, digit_7, digit_8, data):
    """3 (1): what a drive sends for class 0."""
    fields = write_field(encoding, 2, address)
    fields = fields + write_field(encoding, 1, response)
    fields = fields + write_field(encoding, 2, state)
    fields = fields + write_field(encoding, 1, group)
    fields = fields + write_field(encoding, 1, digit_7)
    fields = fields + write_field(encoding, 1, digit_8)
    fields = fields + write_field(encoding, 4, data)
    return seal(encoding, fields)
