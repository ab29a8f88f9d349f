"""Division of a worked frame into fields by model, encoding, direction and length, from the manuals."""

from __future__ import annotations

from typing import Any

from drivebus.values import Text

HEAD, ADDRESS, END = Text("head", "帧头"), Text("address", "站号"), Text("end mark", "帧尾")
KIND, OPERATION = Text("class", "命令类别"), Text("operation", "操作命令")
RESPONSE, STATE = Text("response", "从机响应"), Text("state", "状态反馈")
GROUP, ITEM = Text("group", "数据分类"), Text("item", "数据地址/分项")
DATA, SUM = Text("data", "数据"), Text("checksum", "校验和")
FAULT, INFO = Text("fault code", "故障代码"), Text("information", "特征信息")
FUNCTION, REGISTER = Text("function", "命令码"), Text("register", "寄存器地址")
COUNT, BYTE_COUNT = Text("number of registers", "读取字数"), Text("byte count", "字节数")
VALUE, CRC, LRC = Text("value", "数据"), Text("CRC, low byte first", "CRC（低字节在前）"), Text("LRC", "LRC")
SUB_FUNCTION, EXCEPTION = Text("sub-function", "测试功能号"), Text("exception code", "错误码")
ERROR, ZERO = Text("error mark", "错误标志"), Text("always 00", "固定 00")
CONSTANT, ASK, ANSWER = (
    Text("constant S", "常数 S"),
    Text("A: one drive or all", "A：命令认可"),
    Text("B: reply", "B：回复认可"),
)
COMMAND, PARAMETER = Text("command", "运转命令"), Text("parameter", "参数号码")
QUERY = Text("query item", "查询项")

Layout = list[tuple[Text, int]]
"""Fields in order with their sizes in bytes as sent."""


def layout(vector: dict[str, Any]) -> Layout:
    """Return the fields of a frame. Raises ValueError where their sizes do not add up."""
    size = len(bytes.fromhex(vector["hex"]))
    model = vector["model"]
    found = _c320(vector, size) if model == "c320" else _dzb100(vector) if model == "dzb100" else _modbus(vector)
    if sum(length for _, length in found) != size:
        raise ValueError(f"{vector['id']}: {size} bytes, {found}")
    return found


def _c320(vector: dict[str, Any], size: int) -> Layout:
    """Return the fields of a C320 frame, as §3 of its manual parts them."""
    fields = vector["fields"]
    if vector["direction"] == "request":
        kind = fields["class"]
        middle: dict[int, Layout] = {
            0: [(GROUP, 1), (ZERO, 2)],
            1: [(GROUP, 1), (ITEM, 2)],
            2: [(GROUP, 1), (ITEM, 2)],
            3: [(GROUP, 1), (ITEM, 2), (DATA, 4)],
            4: [(DATA, 4)],
            5: [(GROUP, 1), (ITEM, 2), (DATA, 4)],
        }
        return [(HEAD, 1), (ADDRESS, 2), (KIND, 1), (OPERATION, 2), *middle[kind], (SUM, 4), (END, 1)]
    if size == 11:
        return [(HEAD, 1), (ADDRESS, 2), (RESPONSE, 1), (ZERO, 2), (SUM, 4), (END, 1)]
    if "info" in fields:
        tail: Layout = [(INFO, 6)]
    else:
        tail = [(FAULT if "fault_code" in fields else ITEM, 2), (DATA, 4)]
    return [(HEAD, 1), (ADDRESS, 2), (RESPONSE, 1), (STATE, 2), (GROUP, 1), *tail, (SUM, 4), (END, 1)]


def _dzb100(vector: dict[str, Any]) -> Layout:
    """Return the fields of a DZB100 frame, as §2.2 (5) of its manual parts them."""
    third = ASK if vector["direction"] == "request" else ANSWER
    fourth = {"C": COMMAND, "Q": QUERY}.get(vector["fields"]["head"], PARAMETER)
    return [(HEAD, 1), (CONSTANT, 1), (third, 1), (ADDRESS, 2), (fourth, 2), (DATA, 4)]


def _modbus(vector: dict[str, Any]) -> Layout:
    """Return the fields of a Modbus frame; in ASCII every byte is sent as two characters."""
    body = [(ADDRESS, 1), (FUNCTION, 1), *_pdu(vector)]
    if vector["encoding"] == "rtu":
        return [*body, (CRC, 2)]
    return [(HEAD, 1), *((name, 2 * size) for name, size in body), (LRC, 2), (END, 2)]


def _pdu(vector: dict[str, Any]) -> Layout:
    fields = vector["fields"]
    if fields.get("error"):
        return [(ERROR, 1)]
    if "exception" in fields:
        return [(EXCEPTION, 1)]
    if fields["function"] == 8:
        return [(SUB_FUNCTION, 2), (DATA, 2)]
    if fields["function"] == 6:
        return [(REGISTER, 2), (VALUE, 2)]
    if vector["direction"] == "request":
        return [(REGISTER, 2), (COUNT, 2)]
    return [(BYTE_COUNT, 1), *((VALUE, 2) for _ in fields["registers"])]
