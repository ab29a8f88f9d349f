"""Whatever stands in the file: a plant or a refusal in words, never anything else."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivebus.errors import ConfigurationError
from drivebus.service import config
from drivebus.service.config.model import PlantConfig

SAMPLE = (Path(config.__file__).parent / "sample.en.toml").read_text(encoding="utf-8").splitlines()
KEYS = [number for number, line in enumerate(SAMPLE) if "=" in line.partition("#")[0]]
HEADERS = [number for number, line in enumerate(SAMPLE) if line.startswith("[")]
VALUES = [
    "0",
    "-1",
    "1e308",
    "nan",
    "inf",
    "true",
    '""',
    '"x"',
    '"fan-1"',
    '"pump-1"',
    '"../x.toml"',
    "[]",
    '["fan-1"]',
    "[[]]",
    "{}",
    "{ x = 1 }",
    "{ fan-1 = 0.5 }",
    "1979-05-27",
    "99999999999999999999",
    '"[[["',
    '"a.b > 1 A"',
    '"\\u0000"',
    '"sim://c320@1?baud=0"',
    '"tcp://[::1]:99999"',
    '"rfc2217://"',
    '"memory://m"',
    '"http://x:x/y"',
    '"postgresql://u:p@[::1/x"',
    '"/dev/null"',
    '"/proc/self/mem"',
    '"/proc/kcore"',
    '"/proc/kmsg"',
]


@st.composite
def spoiled(draw: st.DrawFn) -> str:
    """The sample with some of its lines spoiled."""
    lines = list(SAMPLE)
    for _ in range(draw(st.integers(1, 4))):
        what = draw(st.sampled_from(["value", "key", "delete", "double", "header", "swap"]))
        number = draw(st.sampled_from(HEADERS if what == "header" else KEYS))
        key, _, rest = lines[number].partition("=")
        if what == "value":
            lines[number] = f"{key}= {draw(st.sampled_from(VALUES))}"
        elif what == "key":
            lines[number] = f"{draw(st.sampled_from(['id', 'drives', 'limits', 'bus', 'x', 'link.y']))} ={rest}"
        elif what == "delete":
            lines[number] = ""
        elif what == "double":
            lines.insert(number, lines[number])
        elif what == "header":
            lines[number] = draw(
                st.sampled_from(["[drive]", "[bus.fans]", "[alarm.x.y]", "[[group]]", "[gateway.web]", "x"])
            )
        else:
            other = draw(st.sampled_from(KEYS))
            lines[number], lines[other] = lines[other], lines[number]
    return "\n".join(lines)


def check_refusal(text: str) -> None:
    try:
        found = config.loads(text)
    except ConfigurationError as error:
        assert 1 <= len(error.params["diagnostics"]) <= 100
        for diagnostic in error.params["diagnostics"]:
            assert (diagnostic.line is not None or diagnostic.catalogue == "profiles") and diagnostic.remedy.en
            assert diagnostic.text("en") and diagnostic.text("zh")
    else:
        assert isinstance(found, PlantConfig)
        assert config.bus_loads(found)


@settings(max_examples=100)
@given(spoiled())
def test_a_spoiled_file_is_a_plant_or_is_refused_in_words(text: str) -> None:
    check_refusal(text)


@pytest.mark.parametrize("value", VALUES)
def test_no_value_of_a_key_is_more_than_a_diagnostic(value: str) -> None:
    """Each value in every fifth place, so that together they are everywhere."""
    for number in KEYS[VALUES.index(value) % 5 :: 5]:
        lines = list(SAMPLE)
        lines[number] = f"{lines[number].partition('=')[0]}= {value}"
        check_refusal("\n".join(lines))


@pytest.mark.parametrize("path", ["/proc/kcore", "/proc/kmsg", "/proc/self/mem"])
def test_a_models_path_reads_nothing_without_an_end(path: str) -> None:
    """A text may come from afar: the service that judges it must not hang, nor fill its memory."""
    with pytest.raises(ConfigurationError) as caught:
        config.loads("\n".join(SAMPLE).replace('"vc660"', f'"{path}"'))
    assert caught.value.params["diagnostics"][0].kind in ("refused_model", "no_file")
