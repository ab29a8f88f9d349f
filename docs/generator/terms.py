"""Terms of the generated tables in both languages, and small Markdown helpers."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from drivebus import i18n
from drivebus.profiles.model import Evidence
from drivebus.values import Text

PHRASES: dict[str, str] = json.loads((Path(__file__).parent / "phrases.zh.json").read_text(encoding="utf-8"))
"""English sentences of vectors → Chinese."""
BITS = {
    "start": Text("start", "启动"),
    "stop": Text("stop as the drive is set to", "按停机方式停机"),
    "forward": Text("forward", "正转"),
    "reverse": Text("reverse", "反转"),
    "jog_forward": Text("jog forward", "正转点动"),
    "jog_reverse": Text("jog in reverse", "反转点动"),
    "jog_stop": Text("end the jog", "点动停止"),
    "coast": Text("coast to a stop", "自由停车"),
    "quick_stop": Text("emergency stop", "紧急停车"),
    "pause": Text("pause the run", "运行暂停"),
    "hold_ramp": Text("hold the ramp", "加减速禁止"),
    "reset": Text("reset the fault", "故障复位"),
    "ready": Text("ready", "变频器就绪"),
    "fault": Text("in fault", "故障中"),
    "under_voltage": Text("DC bus under-voltage", "直流欠压"),
    "running": Text("running", "运行中"),
    "emergency_stopping": Text("emergency stop under way", "紧急停车过程中"),
    "paused": Text("run paused", "运行暂停中"),
    "not_ready": Text("not ready", "未就绪"),
    "stopped": Text("stopped", "停机"),
    "jogging_forward": Text("jogging forward", "正转点动运行中"),
    "jogging_reverse": Text("jogging in reverse", "反转点动运行中"),
    "accelerating": Text("accelerating", "加速中"),
    "decelerating": Text("decelerating", "减速中"),
    "braking": Text("braking", "制动中"),
    "restarting": Text("restarting", "重新启动中"),
    "speed_search": Text("searching the speed", "检测速度过程中"),
    "dc_braking": Text("DC braking", "直流制动运行中"),
    "jogging": Text("jogging", "点动运行中"),
    "set_reverse": Text("set direction is reverse", "设定频率方向为反转"),
    "output_reverse": Text("output direction is reverse", "输出频率方向为反转"),
}
"""Functions of the bits of command and status words, in the words of the manuals."""
TERMS = {
    "model": Text("model", "型号"),
    "maker": Text("maker", "厂家"),
    "encodings": Text("encodings", "编码"),
    "line": Text("default settings", "默认通信参数"),
    "addresses": Text("addresses", "站号"),
    "broadcast": Text("broadcast", "广播"),
    "none": Text("none", "无"),
    "lacks": Text("does not have", "不具备"),
    "grade": Text("grade", "等级"),
    "what": Text("property", "项目"),
    "value": Text("value", "值"),
    "source": Text("source", "依据"),
    "notation": Text("notation", "编号"),
    "name": Text("name", "名称"),
    "meaning": Text("meaning", "含义"),
    "unit": Text("unit", "单位"),
    "step": Text("step", "步长"),
    "period": Text("period", "周期"),
    "values": Text("values", "取值"),
    "code": Text("code", "代码"),
    "label": Text("keypad", "面板"),
    "cause": Text("cause", "原因"),
    "remedy": Text("remedy", "处理"),
    "id": Text("id", "编号"),
    "command": Text("command", "命令"),
    "mask": Text("mask", "掩码"),
    "acts": Text("acts as", "方式"),
    "pulse": Text("pulse", "脉冲"),
    "level": Text("level", "电平"),
    "under": Text("under setting", "设置条件"),
    "before": Text("status before", "发送前的状态字"),
    "after": Text("status after", "发送后的状态字"),
    "bytes": Text("position", "字节"),
    "hex": Text("bytes", "数据"),
    "field": Text("field", "字段"),
    "option": Text("option", "选项"),
    "default": Text("default", "默认值"),
    "value_in_force": Text("value", "取值"),
    "question": Text("question", "问题"),
    "reason": Text("why this value", "取此值的理由"),
    "procedure": Text("how to determine it on a drive", "如何在实机上确定"),
    "printed": Text("printed", "手册所印"),
    "wrong": Text("error", "错误所在"),
    "correct": Text("a correct sender emits", "正确的发送方发出"),
    "frame": Text("frame", "帧"),
    "nothing": Text("nothing published", "未公布"),
    "no_status": Text("no status register is published", "未公布状态寄存器"),
    "index_unknown": Text(
        "The manual does not give the index of these; they can be used once `[group_sizes]` in a profile of your own "
        "gives it:",
        "手册未给出下列参数的索引；在自己的型号文件 `[group_sizes]` 中给出各组大小后即可使用：",
    ),
    "factory": Text("factory", "出厂值"),
    "others": Text("others not published", "其余未公布"),
    "baud_rates": Text("baud rates", "波特率"),
    "formats": Text("formats", "字符格式"),
    "gap": Text("silence before a frame", "帧前静默"),
    "reply": Text("reply begins within", "应答开始时限"),
    "lateness": Text("longest lateness of a reply", "最长迟到时间"),
    "setpoint": Text("setpoint step", "设定频率步长"),
    "limits": Text("frequency limits until narrowed", "频率限值（可收窄）"),
    "writes": Text("writes", "写入"),
    "comm_loss": Text("communication loss", "通信中断"),
    "wiring": Text("Wiring", "接线"),
    "ram_and_eeprom": Text("RAM, and EEPROM on request", "RAM；指定时写 EEPROM"),
    "eeprom_only": Text("every write counts as EEPROM", "每次写入都按 EEPROM 计"),
    "characters": Text("characters", "字符"),
    "never_less": Text("never less than", "不小于"),
    "default_encoding": Text(" (default)", "（默认）"),
    "time": Text("time", "时间"),
    "action": Text("action", "动作"),
    "request": Text("request", "请求"),
    "response": Text("response", "应答"),
    "answers": Text("answers", "应答对象"),
    "models_by_maker": Text(
        "Every model that drivebus knows, by maker. `drivebus models --search WORD` searches them.",
        "drivebus 支持的全部型号，按厂家排列。可用 `drivebus models --search WORD` 查找。",
    ),
    "erratum": Text("Erratum", "勘误"),
    "hazard": Text("Hazard", "危险"),
    "ambiguous": Text("Ambiguous; the manual meant", "有歧义，手册本意为"),
    "fields": Text("Fields", "字段"),
}
GRADES = {
    "draft": Text("draft", "draft（草案）"),
    "simulated": Text("simulated", "simulated（已模拟）"),
    "verified": Text("verified", "verified（已验证）"),
}
CAPABILITIES = {
    "reverse": Text("reverse", "反转"),
    "coast": Text("coast", "自由停车"),
    "quick_stop": Text("quick stop", "快速停机"),
    "jog": Text("jog", "点动"),
    "write_ram": Text("write without EEPROM", "不写 EEPROM 的写入"),
    "identify": Text("identify", "读型号"),
    "broadcast_stop": Text("broadcast stop", "广播停机"),
    "status": Text("report its state", "报告运行状态"),
}
"""Capabilities that not every model has."""


def term(name: str, language: str) -> str:
    return localized(TERMS[name], language)


def localized(text: Text, language: str) -> str:
    chosen: str = getattr(text, language)
    return chosen


def evidence_kind(kind: str, language: str) -> str:
    """Return the words for a kind of evidence that the page of the service has too."""
    return i18n.text(f"page.evidence_{kind}", language)


def evidence(found: Evidence, language: str) -> str:
    """Return the kind of evidence and its source."""
    kind = evidence_kind(found.kind, language)
    source = localized(found.source, language)
    if not source:
        return kind
    mark = " " if source.startswith("§") else colon(language)
    return f"{kind}{mark}{source}"


def phrase(sentence: str, language: str) -> str:
    """Return a sentence of a vector; one without a Chinese phrase is cited as it is."""
    wordless = re.search("[a-z]{2,}", sentence) is None
    return sentence if language == "en" or wordless else PHRASES.get(sentence, sentence)


def named_placeholders(message: str) -> str:
    """Return a message of a catalogue with the name of each placeholder in italics."""
    return re.sub(r"\{([a-z_]+)[^}]*\}", r"*\1*", message).replace("{{", "{").replace("}}", "}")


def colon(language: str) -> str:
    return ": " if language == "en" else "："


def table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = ["| " + " | ".join(heads) + " |", "| " + " | ".join("---" for _ in heads) + " |"]
    lines += ["| " + " | ".join(_cell(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _cell(value: object) -> str:
    return str(value).replace("|", "\\|").replace("\n", " ") or " "
