"""Unusual but valid plant files are accepted: the valid side of each check."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivebus import profiles
from drivebus.errors import ConfigurationError
from drivebus.ports.url import parse_port_url
from drivebus.service import config
from drivebus.service.config.check_buses import device_of
from drivebus.service.config.model import AlarmKind, AlarmPriority, PlantConfig, RetentionConfig
from drivebus.service.interlocks.expression import STATE_WORDS
from fixtures.service import FAN_FILE

HEAD = (
    FAN_FILE
    + """[bus.b]
port = "tcp://127.0.0.1:2"
[drive.pump]
bus = "b"
address = 1
model = "vc660"
[bus.c]
port = "tcp://127.0.0.1:3"
[drive.raw]
bus = "c"
address = 1
model = "df800"
"""
)


def kinds(text: str) -> list[str]:
    with pytest.raises(ConfigurationError) as caught:
        config.loads(text)
    return [diagnostic.kind for diagnostic in caught.value.params["diagnostics"]]


def plant(more: str = "", **edits: str) -> PlantConfig:
    text = HEAD
    for drive, keys in edits.items():
        text = text.replace(f"[drive.{drive}]\n", f"[drive.{drive}]\n{keys}\n")
    return config.loads(text + more)


@pytest.mark.parametrize("address", [0, 30])
def test_the_first_and_the_last_address_of_a_model(address: int) -> None:
    text = HEAD.replace('bus = "a"\naddress = 1', f'bus = "a"\naddress = {address}')
    assert config.loads(text).drive("fan").address == address


def test_limits_as_wide_as_the_models_own_and_one_direction() -> None:
    limits = plant(fan="limits = { minimum_hz = 0.0, maximum_hz = 50.0, reverse = false }").drive("fan").limits
    assert (limits.minimum_hz, limits.maximum_hz, limits.forward, limits.reverse) == (0.0, 50.0, True, False)
    assert plant(fan="limits = { minimum_hz = 49.9 }").drive("fan").limits.maximum_hz is None
    assert kinds(HEAD.replace("[drive.fan]", "[drive.fan]\nlimits = { minimum_hz = 50.0 }")) == ["limits"]


def test_options_accept_the_choices_and_spans_of_open_questions() -> None:
    settings = "options = { monitor_index = 'bcd', nibble = true, class4_item = 255 }"
    assert plant(fan=settings).drive("fan").options == {"monitor_index": "bcd", "nibble": True, "class4_item": 255}
    assert plant(fan="options = { class4_item = 'unknown' }").drive("fan").options == {"class4_item": "unknown"}
    for wrong in ("nibble = 1", "class4_item = 256", "class4_item = -1", "class4_item = true", "class4_item = 1.0"):
        assert kinds(HEAD.replace("[drive.fan]", f"[drive.fan]\noptions = {{ {wrong} }}")) == ["choice"], wrong


def test_another_encoding_on_a_bus_of_its_own() -> None:
    assert plant(fan="encoding = 'hex'").drive("fan").encoding == "hex"


def test_every_key_of_a_drive_and_of_the_plant_is_configured() -> None:
    found = plant(
        pump="title = { en = 'Pump', zh = '泵' }\non_client_lost = 'stop'\non_service_stop = 'hold'\n"
        "on_restart = 'stop'\nmin_poll_interval_s = 2.5\nsignals = { output_current = 4.0 }",
        raw="limits = { eeprom_writes_per_day = 3, forward = false }",
    )
    pump = found.drive("pump")
    assert (pump.title.en, pump.title.zh, pump.min_poll_interval_s, pump.signals) == (
        "Pump",
        "泵",
        2.5,
        {"output_current": 4.0},
    )
    assert (pump.on_client_lost, pump.on_service_stop, pump.on_restart) == ("stop", "hold", "stop")
    assert (found.drive("raw").limits.eeprom_writes_per_day, found.drive("raw").limits.forward) == (3, False)
    with pytest.raises(KeyError):
        found.drive("unknown")


def test_a_user_profile_is_found_by_a_path_relative_to_the_file(tmp_path: Path) -> None:
    (tmp_path / "spindle.toml").write_text('format = 1\nextends = "vc660"\n[limits]\nmaximum_hz = 400.0\n')
    (tmp_path / "plant.toml").write_text(
        HEAD.replace('model = "vc660"', 'model = "spindle.toml"\nlimits = { maximum_hz = 300.0 }'), encoding="utf-8"
    )
    found = config.load(tmp_path / "plant.toml").drive("pump")
    assert found.model == str(tmp_path / "spindle.toml") and found.limits.maximum_hz == 300.0
    assert config.profile_of(found).limits.maximum_hz == 400.0


# --- lines --------------------------------------------------------------------------------------------------------


def test_a_private_simulated_bus_may_be_named_twice_but_not_a_shared_one() -> None:
    two = 'format = 1\n[plant]\nid = "p"\n[bus.a]\nport = "sim://c320@1{0}"\n[bus.b]\nport = "sim://c320@1{0}"\n'
    assert len(config.loads(two.format("")).buses) == 2
    assert kinds(two.format("?name=x")) == ["one_device"]


def test_one_device_by_two_names_is_one_device(tmp_path: Path) -> None:
    device, other = tmp_path / "ttyUSB0", tmp_path / "by-id"
    device.touch()
    other.symlink_to(device)
    assert device_of(parse_port_url(str(device))) == device_of(parse_port_url(f"serial://{other}?baud=19200"))
    assert (
        device_of(parse_port_url("tcp://h:1"))
        == device_of(parse_port_url("rfc2217://h:1"))
        != device_of(parse_port_url("tcp://h:2"))
    )
    assert (
        device_of(parse_port_url("memory://x"))
        == device_of(parse_port_url("memory://x"))
        != device_of(parse_port_url("sim://x"))
    )


def test_serial_settings_are_the_files_then_the_port_urls_then_the_factory_settings() -> None:
    text = HEAD.replace("[drive.fan]", "baud = 19200\n[drive.fan]")
    found = config.loads(text)
    assert [str(config.serial_settings_in(found, bus)) for bus in "abc"] == ["19200 8E1", "9600 8N1", "9600 8N1"]
    with pytest.raises(KeyError):
        config.serial_settings_in(found, "d")
    empty = config.loads(HEAD + '[bus.d]\nport = "tcp://127.0.0.1:4?baud=1200"\n')
    assert str(config.serial_settings_in(empty, "d")) == "1200 8N1"


def test_models_of_one_protocol_share_a_bus() -> None:
    more = '[drive.fan-2]\nbus = "a"\naddress = 2\nmodel = "c300"\n'
    assert plant(more).drive("fan-2").model == "c300"


def test_a_period_as_long_as_its_transaction_is_accepted() -> None:
    once_s = config.bus_loads(plant(fan="signals = { output_frequency = 1.0 }"))[0].cycle_s
    edge = f"signals = {{ output_frequency = {once_s + 1e-6:.6f} }}"
    assert plant(fan=edge).drive("fan").signals["output_frequency"] == pytest.approx(once_s, abs=1e-5)
    fast = HEAD.replace("[drive.fan]", f"[drive.fan]\nsignals = {{ output_frequency = {once_s - 1e-3:.6f} }}")
    assert kinds(fast) == ["too_often"]
    slowed = plant(fan=f"min_poll_interval_s = 1.0\nsignals = {{ output_frequency = {once_s - 1e-3:.6f} }}")
    assert config.bus_loads(slowed)[0].drives[0].periods == {"output_frequency": 1.0}


# --- rules --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("drives", "require"),
    [
        ('["pump"]', "pump.temperature < 80 °C"),  # of itself, and not a matter of running
        ('["fan", "pump"]', "fan.output_frequency < 45 Hz and pump.output_frequency < 45 Hz"),
        ('["fan"]', "pump.state == running or pump.temperature < 80 °C"),
        ('["fan"]', "not pump.state == fault"),
        ('["fan"]', "pump.output_frequency >= fan.output_frequency"),
        ('["fan"]', "pump.output_current < 12000 mA"),
        ('["fan"]', "pump.output_terminals == 0"),
        ('["fan"]', " and ".join(f"pump.state != {word}" for word in STATE_WORDS if word != "running")),
    ],
)
def test_an_interlock_that_can_be_met_is_accepted(drives: str, require: str) -> None:
    found = plant(f'[interlock.i]\ndrives = {drives}\nrequire = "{require}"\naction = "block_start"\ndelay_s = 1.5\n')
    lock = found.interlocks[0]
    assert (lock.require, lock.action, lock.delay_s, lock.title.en) == (require, "block_start", 1.5, "i")


def test_a_chain_of_interlocks_is_no_cycle_and_a_long_cycle_is_named() -> None:
    def lock(id: str, drive: str, first: str) -> str:
        return f'[interlock.{id}]\ndrives = ["{drive}"]\nrequire = "{first}.output_frequency > 5 Hz"\n'

    more = '[drive.fan-2]\nbus = "a"\naddress = 2\nmodel = "c320"\n'
    chain = more + lock("x", "fan", "pump") + lock("y", "fan-2", "fan")
    assert len(plant(chain).interlocks) == 2
    assert kinds(HEAD + chain + lock("z", "pump", "fan-2")) == ["cycle"]


def test_an_alarm_without_drives_applies_to_all_that_poll_the_signal() -> None:
    more = '[alarm.x]\nkind = "above"\nsignal = "output_frequency"\nthreshold = 45.0\n'
    found = plant(more).alarms[0]
    assert (found.kind, found.drives, found.priority) == (AlarmKind.ABOVE, ("fan", "pump"), AlarmPriority.HIGH)
    assert (found.title.en, found.title.zh) == ("", ""), "its kind says what it is"
    every = plant('[alarm.y]\nkind = "stale"\npriority = "low"\ntitle = "Old"\n').alarms[0]
    assert (every.drives, every.signal, every.title.zh) == ((), None, "Old")


@pytest.mark.parametrize(
    "keys",
    [
        'kind = "above"\nthreshold = 200.0',
        'kind = "below"\nthreshold = -40.0',
        'kind = "above"\nthreshold = 0.0\nhysteresis = 40.0',
        'kind = "below"\nthreshold = 100.0\nhysteresis = 100.0',
        'kind = "stale"',
    ],
)
def test_thresholds_at_the_bounds_of_a_signals_range_are_accepted(keys: str) -> None:
    assert plant(f'[alarm.x]\ndrives = ["pump"]\nsignal = "temperature"\n{keys}\n').alarms[0].drives == ("pump",)


def test_a_signal_without_unit_may_have_an_alarm() -> None:
    more = (
        '[alarm.x]\nkind = "above"\ndrives = ["raw"]\nsignal = "output_current"\nthreshold = 5000.0\nhysteresis = 1e6\n'
    )
    assert plant(more).alarms[0].threshold == 5000.0


def test_every_key_of_a_group_is_used() -> None:
    more = (
        '[group.g]\ndrives = ["fan", "pump"]\nleader = "pump"\nratios = { fan = 0.5 }\n'
        'start_interval_s = 2.0\nmax_concurrent_starts = 2\ntitle = "Both"\n'
    )
    group = plant(more).groups[0]
    assert (group.drives, group.leader, group.ratios) == (("fan", "pump"), "pump", {"fan": 0.5})
    assert (group.start_interval_s, group.max_concurrent_starts, group.title.zh) == (2.0, 2, "Both")


# --- places -------------------------------------------------------------------------------------------------------


def test_the_web_gateway_may_listen_on_every_address_with_a_certificate(tmp_path: Path) -> None:
    for name in ("plant.crt", "plant.key"):
        (tmp_path / name).touch()
    more = '[gateway.web]\nhost = "0.0.0.0"\nport = 0\ncertificate = "plant.crt"\nkey = "plant.key"\norigins = ["https://a.b:8443"]\n'
    web = config.loads(HEAD + more, base=tmp_path).gateway("web").settings
    assert (web.host, web.port, web.origins) == ("0.0.0.0", 0, ("https://a.b:8443",))
    assert (web.certificate, web.key) == (tmp_path / "plant.crt", tmp_path / "plant.key")


@pytest.mark.parametrize(
    "url", ["postgresql://u@127.0.0.1/plant", "postgres://u:p@[::1]:5432/plant", "postgresql:///plant?host=/run/pg"]
)
def test_the_url_of_a_database_is_kept_as_written(url: str) -> None:
    assert plant(f'[history]\nurl = "{url}"\n').history.url == url


def test_equal_retention_times_are_accepted_and_configured() -> None:
    days = "raw_days = 7.0\nrollup_1s_days = 7.0\nrollup_1min_days = 8.0\nrollup_1h_days = 9.0\n"
    more = f"[history]\nmax_size_mb = 50.0\n[history.retention]\n{days}"
    found = plant(more).history
    retention = RetentionConfig(raw_days=7, rollup_1s_days=7, rollup_1min_days=8, rollup_1h_days=9)
    assert (found.retention, found.max_size_mb) == (retention, 50)


def test_a_state_directory_may_exist_or_not(tmp_path: Path) -> None:
    for name in (".", "new/state"):
        keys = f'id = "p"\ndirectory = "{name}"\nusers = "users.json"'
        found = config.loads(HEAD.replace('id = "p"', keys), base=tmp_path)
        assert (found.directory, found.users) == ((tmp_path / name).resolve(), tmp_path / "users.json")


def test_an_expression_may_have_several_lines_and_a_title_may_be_chinese() -> None:
    require = '"""\npump.state == running and\n\tpump.temperature < 80 ℃"""'
    more = f'[interlock.i]\ndrives = ["fan"]\nrequire = {require}\ntitle = "水泵先行 №1"\n'
    assert plant(more).interlocks[0].title.en == "水泵先行 №1"


def test_a_lower_limit_below_the_models_own_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "slow.toml").write_text('format = 1\nextends = "vc660"\n[limits]\nminimum_hz = 10.0\n')
    text = HEAD.replace('model = "vc660"', 'model = "slow.toml"\nlimits = { minimum_hz = 10.0 }')
    assert config.loads(text, base=tmp_path).drive("pump").limits.minimum_hz == 10.0
    with pytest.raises(ConfigurationError) as caught:
        config.loads(text.replace("{ minimum_hz = 10.0", "{ minimum_hz = 9.9"), base=tmp_path)
    found = caught.value.params["diagnostics"]
    assert [(diagnostic.kind, diagnostic.expected.en) for diagnostic in found] == [("limit_wide", ">= 10 for vc660")]


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ("signals = { output_frequency = 500 }", [("drive.fan.signals.output_frequency", "500", "0.5", "1500 s")]),
        (
            "signals = { output_frequency = 60.5 }",
            [("drive.fan.signals.output_frequency", "60.5", "0.0605", "181.5 s")],
        ),
        ("min_poll_interval_s = 500", [("drive.fan.min_poll_interval_s", "500", "0.5", "1500 s")]),
        ("min_poll_interval_s = 60\nsignals = { output_frequency = 60 }", []),
    ],
)
def test_an_interval_in_milliseconds_is_a_warning_with_its_line_and_the_value_in_seconds(
    keys: str, expected: list[tuple[str, str, str, str]]
) -> None:
    """Regression: 500, meant as milliseconds, was accepted silently, and a lost drive looked current for 25 minutes."""
    found = plant(fan=keys).warnings
    assert [(warning.key, warning.found.en) for warning in found] == [(key, value) for key, value, *_ in expected]
    for warning, (key, value, seconds, valid) in zip(found, expected, strict=True):
        text = warning.text("en")
        assert warning.line == HEAD.split("[drive.fan]")[0].count("\n") + 2 and f"plant.toml:{warning.line}" in text
        for part in (key, f"{value} milliseconds", f"write {seconds};", valid, "in seconds, at most 60"):
            assert part in text
        assert f"{value} 毫秒" in warning.text("zh")


def test_a_signal_that_its_model_reads_seldom_may_be_read_as_seldom() -> None:
    model = next(
        name for name in profiles.models() if any(s.period_s > 60 for s in profiles.load(name).signals.values())
    )
    slow = next(signal for signal in profiles.load(model).signals.values() if signal.period_s > 60)
    text = HEAD + f'[bus.d]\nport = "tcp://127.0.0.1:4"\n[drive.slow]\nbus = "d"\naddress = 1\nmodel = "{model}"\n'
    least = f"signals.{slow.name} = {slow.period_s}\n"
    assert config.loads(text + least).warnings == ()
    assert len(config.loads(text + least.replace(str(slow.period_s), str(slow.period_s + 1))).warnings) == 1
