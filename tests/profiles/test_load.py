"""Finding, extending and overriding profiles."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivebus import profiles
from drivebus.errors import ProfileError
from drivebus.profiles import DriveProfile
from drivebus.profiles.load import included_models
from fixtures.drives import writable_registers

VC660_SIZES = """
format = 1
extends = "vc660"
title = { en = "VC660 of line 2", zh = "二号线 VC660" }

[group_sizes]
F00 = 30
F01 = 20
F02 = 15
F03 = 12
F04 = 10
F05 = 16
F06 = 8

[limits]
maximum_hz = 400.0

[timing]
reply_delay_s = 0.03
"""


def write(directory: Path, text: str, name: str = "own.toml") -> Path:
    path = directory / name
    path.write_text(text, encoding="utf-8")
    return path


def test_the_eight_models_come_with_drivebus() -> None:
    assert {"c320", "dzb100", "vc660", "df800", "c300", "e300", "e350", "e500", "e550"} <= set(profiles.models())


@pytest.mark.parametrize("model", ["c320", "dzb100", "vc660", "df800", "c300", "e300", "e350", "e500", "e550"])
def test_every_model_that_comes_with_drivebus_loads(model: str) -> None:
    assert profiles.load(model).model == model


def test_group_sizes_give_the_parameters_their_consecutive_index(tmp_path: Path) -> None:
    profile = profiles.load(write(tmp_path, VC660_SIZES))
    assert profile.parameters["F01.00"].locator == ("holding", 30)
    assert profile.parameters["F06.06"].locator == ("holding", 30 + 20 + 15 + 12 + 10 + 16 + 6)
    assert not profile.unplaced
    assert all(condition.unreadable is None for condition in profile.preconditions)


def test_an_extension_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    base, own_profile = profiles.load("vc660"), profiles.load(write(tmp_path, VC660_SIZES))
    assert own_profile.limits.maximum_hz == 400.0
    assert own_profile.limits.minimum_hz == base.limits.minimum_hz
    assert own_profile.timing.reply_delay_s == 0.03
    assert own_profile.timing.max_reply_lateness_s == base.timing.max_reply_lateness_s
    assert own_profile.title.en == "VC660 of line 2"
    assert own_profile.signals == base.signals
    assert own_profile.source.endswith("own.toml")


def test_no_profile_promises_replies_later_than_a_bus_takes_into_account(tmp_path: Path) -> None:
    own = "reply_delay_s = 0.03\nmax_reply_lateness_s = "
    assert profiles.load(write(tmp_path, VC660_SIZES.replace("reply_delay_s = 0.03", own + "5"))).timing
    with pytest.raises(ProfileError, match="max_reply_lateness_s"):
        profiles.load(write(tmp_path, VC660_SIZES.replace("reply_delay_s = 0.03", own + "5.1")))


def test_df800_status_monitors_can_be_added_as_signals(tmp_path: Path) -> None:
    profile = profiles.load(
        write(
            tmp_path,
            """
format = 1
extends = "df800"
[signals.output_current]
unit = "A"
factor = 0.1
decimals = 1
[signals.output_frequency]
notation = "F0.00"
text = { en = "output frequency", zh = "输出频率" }
unit = "Hz"
factor = 0.01
decimals = 2
evidence = "user: DF800 manual, monitor list"
""",
        )
    )
    assert profile.signals["output_frequency"].locator == ("holding", 0)
    assert profile.signals["output_frequency"].evidence.kind == "user"
    assert profile.signals["output_current"].uncertain is None
    assert profiles.load("df800").signals["output_current"].uncertain == "profiles.scale_unpublished"


@pytest.mark.parametrize(
    ("keys", "uncertain"),
    [
        ("factor = 1.0", False),
        ("factor = 0.1\nscale_published = false", True),
        ("scale_published = true", False),
        ('unit = "A"\ndecimals = 1', True),
    ],
)
@pytest.mark.parametrize("entry", ["signals.output_current", 'parameters."F1.00"'])
def test_a_factor_marks_its_scale_as_published(tmp_path: Path, entry: str, keys: str, uncertain: bool) -> None:
    """DF800's manual gives neither step; a unit alone gives none either."""
    profile = profiles.load(write(tmp_path, f'format = 1\nextends = "df800"\n[{entry}]\n{keys}\n'))
    found = profile.signals["output_current"] if entry.startswith("signals") else profile.parameters["F1.00"]
    assert (found.uncertain is not None) == uncertain


def test_a_c320_monitor_table_can_be_extended(tmp_path: Path) -> None:
    text = 'format = 1\nextends = "c320"\n[signals.torque]\nnotation = "d.9"\n'
    text += 'text = { en = "torque", zh = "转矩" }\nunit = "%"\nevidence = "user"\n'
    assert profiles.load(write(tmp_path, text)).signals["torque"].locator == ("monitor", 9)


def test_a_profile_that_extends_another_replaces_the_values_of_its_options(tmp_path: Path) -> None:
    options = '[options]\ndirection_field.value = "b2b3"\ndirection_calibrated.value = true\n'
    text = f'format = 1\nextends = "df800"\n{options}'
    profile = profiles.load(write(tmp_path, text))
    assert profile.options == {"direction_field": "b2b3", "direction_calibrated": True}
    assert profile.commands is not None
    assert profile.commands.resolved(profile.options).bits["forward"].value == 0x0004


def test_the_limit_of_vc660s_analog_outputs_is_an_option(tmp_path: Path) -> None:
    """The guide prints 0-3ffff, which does not fit 16 bits: analog_limit says what holds."""
    outputs = ("2008H", "2009H")
    assert {profiles.load("vc660").parameters[each].maximum for each in outputs} == {0x3FFF}
    own = write(tmp_path, 'format = 1\nextends = "vc660"\n[options]\nanalog_limit.value = 0xFFFF\n')
    assert {profiles.load(own).parameters[each].maximum for each in outputs} == {0xFFFF}


def test_profiles_extend_each_other_over_several_files(tmp_path: Path) -> None:
    write(tmp_path, VC660_SIZES, "plant.toml")
    last = write(tmp_path, 'format = 1\nextends = "./plant.toml"\n[limits]\nmaximum_hz = 120.0\n', "spindle.toml")
    profile = profiles.load(str(last))
    assert (profile.limits.maximum_hz, profile.group_sizes["F00"]) == (120.0, 30)


def test_a_profile_in_the_users_directory_is_a_model(own_profiles: Path) -> None:
    write(own_profiles, VC660_SIZES, "line2.toml")
    assert "line2" in profiles.models()
    assert profiles.load("line2").limits.maximum_hz == 400.0


def test_a_users_profile_may_extend_another_of_the_users(own_profiles: Path) -> None:
    write(own_profiles, VC660_SIZES, "line2.toml")
    write(own_profiles, 'format = 1\nextends = "line2"\n', "line3.toml")
    assert profiles.load("line3").limits.maximum_hz == 400.0


def test_a_users_file_can_not_replace_a_built_in_model(own_profiles: Path) -> None:
    path = write(own_profiles, VC660_SIZES, "vc660.toml")
    with pytest.raises(ProfileError) as caught:
        profiles.load("vc660")
    assert caught.value.params["diagnostics"][0].kind == "shadows"
    assert caught.value.params["file"] == str(path)


@pytest.mark.parametrize("name", ["VC660", "Vc660", "GD10"])
def test_a_model_is_found_in_any_case(name: str) -> None:
    assert profiles.load(name).model == name.lower()


def test_no_two_included_models_differ_in_case_alone() -> None:
    names = [name.casefold() for name in included_models()]
    assert len(names) == len(set(names))


def test_a_users_file_can_not_replace_a_built_in_model_in_another_case(own_profiles: Path) -> None:
    """``--model VC660`` would be another drive than ``--model vc660``."""
    write(own_profiles, VC660_SIZES, "VC660.toml")
    assert profiles.load("vc660").limits.maximum_hz != 400.0  # a stop by its exact name is not refused
    for name in ("VC660", "Vc660"):
        with pytest.raises(ProfileError) as caught:
            profiles.load(name)
        assert caught.value.params["diagnostics"][0].kind == "shadows"


def test_users_files_that_differ_in_case_alone_are_found_by_their_own_names_only(own_profiles: Path) -> None:
    write(own_profiles, VC660_SIZES, "line2.toml")
    write(own_profiles, VC660_SIZES.replace("400", "300"), "LINE2.toml")
    assert profiles.load("line2").limits.maximum_hz == 400.0 and profiles.load("LINE2").limits.maximum_hz == 300.0
    with pytest.raises(ProfileError):
        profiles.load("Line2")


def test_an_unknown_model_is_answered_with_the_nearest_names() -> None:
    with pytest.raises(ProfileError) as caught:
        profiles.load("vc60")
    diagnostic = caught.value.params["diagnostics"][0]
    assert diagnostic.kind == "no_model"
    assert "vc660" in diagnostic.remedy.en and "drivebus models" in diagnostic.expected.en


def test_a_missing_file_is_reported() -> None:
    with pytest.raises(ProfileError) as caught:
        profiles.load("./nowhere/own.toml")
    assert caught.value.params["diagnostics"][0].kind == "no_file"


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    path = write(tmp_path, VC660_SIZES)
    assert profiles.load(path).limits.maximum_hz == 400.0
    write(tmp_path, VC660_SIZES.replace("400.0", "200.0  # narrower"))
    assert profiles.load(path).limits.maximum_hz == 200.0


def test_a_file_with_windows_line_ends_loads_and_its_faults_keep_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_bytes(VC660_SIZES.replace("\n", "\r\n").encode())
    assert profiles.load(path).limits.maximum_hz == 400.0
    path.write_bytes(b'format = 1\r\nextends = "vc660"\r\n\r\n[timing]\r\ngap = 1\r\n')
    with pytest.raises(ProfileError) as caught:
        profiles.load(path)
    assert caught.value.params["line"] == 5


def test_a_whole_new_modbus_inverter_is_one_file(tmp_path: Path) -> None:
    profile: DriveProfile = profiles.load(
        write(
            tmp_path,
            """
format = 1
model = "acme"
family = "modbus"
grade = "draft"
maker = { en = "Acme", zh = "Acme" }
title = { en = "Acme 1", zh = "Acme 1" }
encodings = ["rtu"]
addresses = [1, 32]
capabilities = ["run", "stop", "read"]
notation = { style = "register" }
serial = { baud = 19200, format = "8E1", bauds = [19200], formats = ["8E1"], evidence = "user" }
timing = { evidence = "assumed" }
limits = { minimum_hz = 0.0, maximum_hz = 50.0, evidence = "user" }
setpoint = { factor = 0.01, decimals = 2, evidence = "user" }
write = { ram = false, evidence = "assumed" }
modbus = { evidence = "user" }
[commands]
register = 0x100
setpoint_register = 0x101
evidence = "user"
bits = { start = { mask = 1, value = 1, pulse = true }, stop = { mask = 2, value = 2, pulse = true } }
[signals.output_frequency]
notation = "0x200"
text = { en = "output frequency", zh = "输出频率" }
unit = "Hz"
evidence = "user"
[signals.output_current]
notation = "0x201"
text = { en = "output current", zh = "输出电流" }
unit = "A"
evidence = "user"
""",
        )
    )
    assert profile.signals["output_frequency"].locator == ("holding", 0x200)
    assert writable_registers(profile) == {0x100, 0x101}


@pytest.mark.parametrize("digits", ["9" * 5000, "１２", "007", "65536"])
def test_a_key_that_is_no_16_bit_number_is_an_issue_of_the_file(tmp_path: Path, digits: str) -> None:
    """Python converts no text of more than 4,300 digits: ``profile check`` ended with a ValueError."""
    file = tmp_path / "own.toml"
    table = f'format = 1\nextends = "vc660"\n[faults."{digits}"]\ntext = {{ en = "a", zh = "b" }}\n'
    file.write_text(table, encoding="utf-8")
    with pytest.raises(ProfileError) as caught:
        profiles.load(file)
    assert [diagnostic.kind for diagnostic in caught.value.params["diagnostics"]] == ["number"]
