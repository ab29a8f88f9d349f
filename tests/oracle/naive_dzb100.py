"""DZB100, read a second time: slow, plain, and sharing no line with ``drivebus``. Sections are the manual's.

Where the manual contradicts itself or is silent: a read's head is R (the text prints P, example 3 prints R), Q is
padded with 0000 like that R, and a C reply's B may be 06 (example 1) as well as the text's X0 to X8.
"""

# Section 2 (4): each digit is one of these characters.
DIGITS = {
    "0": 0x30,
    "1": 0x31,
    "2": 0x32,
    "3": 0x33,
    "4": 0x34,
    "5": 0x35,
    "6": 0x36,
    "7": 0x37,
    "8": 0x38,
    "9": 0x39,
    "A": 0x41,
    "B": 0x42,
    "C": 0x43,
    "D": 0x44,
    "E": 0x45,
    "F": 0x46,
}
VALUES = {
    0x30: 0,
    0x31: 1,
    0x32: 2,
    0x33: 3,
    0x34: 4,
    0x35: 5,
    0x36: 6,
    0x37: 7,
    0x38: 8,
    0x39: 9,
    0x41: 10,
    0x42: 11,
    0x43: 12,
    0x44: 13,
    0x45: 14,
    0x46: 15,
}

# Section 2 (5): the heads.
HEADS = {"control": 0x43, "write": 0x50, "read": 0x52, "query": 0x51}
NAMES = {0x43: "control", 0x50: "write", 0x52: "read", 0x51: "query"}

# "S: checksum 03H", the same in every frame.
CONSTANT_BYTE = 0x03

# A of a request, B of a reply.
DATA_BYTE_ONE = 0x01
BROADCAST_ADDRESS = 0x02
RIGHT = 0x06
WRONG = 0x07

# MM of C, and B of its reply: X0 to X8.
COMMANDS = {
    0: "stop",
    1: "forward",
    2: "stop",
    3: "reverse",
    4: "jog forward",
    5: "jog forward",
    6: "jog reverse",
    7: "jog reverse",
    8: "reset",
}

# CD of Q03, as printed: decimal. Whether the tenth is sent as 10 or as 0A is not said; decimal is our default.
FAULTS = [
    "00",
    "01",
    "02",
    "03",
    "04",
    "05",
    "06",
    "07",
    "08",
    "09",
    "10",
    "11",
    "12",
    "13",
    "14",
    "15",
    "16",
    "17",
    "18",
    "19",
    "20",
]


def two_decimal(number):
    """UU, MM and NN: two decimal digits."""
    if not 0 <= number <= 99:
        raise ValueError("two decimal digits")
    return [DIGITS[str(number // 10)], DIGITS[str(number % 10)]]


def four_hex(number):
    """FFFF and DDDD: four hexadecimal digits."""
    if not 0 <= number <= 0xFFFF:
        raise ValueError("four hexadecimal digits")
    frame = []
    for letter in f"{number:04X}":
        frame.append(DIGITS[letter])
    return frame


def build(kind, address, number, data=0):
    """The 11 bytes of a request; ``number`` is MM or NN. ValueError for what the manual does not define."""
    if not 0 <= address <= 31:
        raise ValueError("UU: 00 to 31")
    if address == 0 and kind != "control":
        raise ValueError("A: only C lists 02, all drives; 0 is the broadcast address (section 2.1)")
    if kind == "control" and number not in COMMANDS:
        raise ValueError("MM: X0 to X8; X is not defined, so 0")
    if kind in ("write", "read") and not 0 <= number <= 80:
        raise ValueError("NN: 00 to 80")
    if kind == "query" and number not in (0, 1, 2, 3):
        raise ValueError("NN of Q: X0 to X3; X is not defined, so 0")
    if kind in ("read", "query") and data != 0:
        raise ValueError("R and Q carry no data: 0000")
    if address == 0:
        a = BROADCAST_ADDRESS
    else:
        a = DATA_BYTE_ONE
    frame = [HEADS[kind], CONSTANT_BYTE, a] + two_decimal(address) + two_decimal(number) + four_hex(data)
    assert len(frame) == 11  # section 2 (4): 11 bytes each
    return bytes(frame)


def build_reply(kind, b, address, number, data):
    """What a drive sends. Nothing is judged, so that undefined numbers can be sent too."""
    return bytes([HEADS[kind], CONSTANT_BYTE, b] + two_decimal(address) + two_decimal(number) + four_hex(data))


def result(kind, b):
    """B: 06 and 07 are words in every reply (C: example 1 shows 06); else the state digit, X not defined."""
    if b == RIGHT:
        return "right"
    if b == WRONG:
        return "wrong"
    return b % 16


def judge(request, reply):
    """What the reply to this request means, as a dict, or "refuse"."""
    kind = NAMES[request[0]]
    if request[2] == BROADCAST_ADDRESS:
        return "refuse"  # section 2: a broadcast is not answered
    if len(reply) != 11:
        return "refuse"  # section 2 (4)
    if reply[0] != request[0]:
        return "refuse"
    if reply[1] != CONSTANT_BYTE:
        return "refuse"
    b = reply[2]
    if kind == "control":
        if b % 16 not in COMMANDS:
            return "refuse"  # B of C: X0 to X8, X not defined; 06 is among them
    elif b not in (RIGHT, WRONG):
        return "refuse"  # B of P, R and Q: 06 or 07
    if reply[3:5] != request[3:5]:
        return "refuse"  # UU
    if reply[5:7] != request[5:7]:
        return "refuse"  # MM or NN
    for byte in reply[7:11]:
        if byte not in VALUES:
            return "refuse"  # section 2 (4)
    if kind in ("control", "write") and b != WRONG and reply[7:11] != request[7:11]:
        return "refuse"  # the reply's FFFF is "as above", whatever B is; examples 1 and 2 give back what was sent
    meaning = {
        "kind": kind,
        "address": VALUES[reply[3]] * 10 + VALUES[reply[4]],
        "number": VALUES[reply[5]] * 10 + VALUES[reply[6]],
        "result": result(kind, b),
        "data": VALUES[reply[7]] * 4096 + VALUES[reply[8]] * 256 + VALUES[reply[9]] * 16 + VALUES[reply[10]],
    }
    if kind == "query" and meaning["number"] == 3 and b == RIGHT:
        if VALUES[reply[7]] not in COMMANDS:
            return "refuse"  # NN = 03: A is the run command, 0 to 8
        fault = chr(reply[9]) + chr(reply[10])
        if fault not in FAULTS:
            return "refuse"  # NN = 03: CD is 00 to 20, 19 and 20 reserved
        meaning["command"] = VALUES[reply[7]]
        meaning["state_digit"] = VALUES[reply[8]]
        meaning["fault_code"] = FAULTS.index(fault)
    return meaning
