"""Full-screen view (textual): tables of drives and buses, messages, and the keys."""

from __future__ import annotations

from rich.text import Text
from textual.app import App, ComposeResult
from textual.events import Resize
from textual.widgets import Footer, Static

from drivebus.cli import output
from drivebus.cli.tui.row_source import KeyCommands, RowSource
from drivebus.cli.tui.tables import CellTable, bus_cells, bus_columns, drive_cells, drive_columns
from drivebus.errors import DrivebusError

REFRESH_PERIOD_S = 0.25
FREQUENCY_STEP_HZ = 5.0
MESSAGE_INDENT = 6  # cells of the time before a message


class MonitorApp(App[int]):
    """View of a row source until q; with ``commands``, keys command the selected drive."""

    ENABLE_COMMAND_PALETTE = False
    CSS = """
    #title { height: 1; background: $primary; color: $text; padding: 0 1; text-style: bold; }
    #title { text-wrap: nowrap; text-overflow: ellipsis; }
    Screen { overflow: hidden; }
    #drives { height: auto; max-height: 60%; overflow-x: hidden; }
    #buses { height: auto; overflow-x: hidden; }
    #legend { height: 1; padding: 0 1; color: $text-muted; }
    #messages { height: 1fr; min-height: 2; padding: 0 1; color: $text-muted; }
    """

    def __init__(self, source: RowSource, commands: KeyCommands | None = None, duration_s: float | None = None) -> None:
        super().__init__()
        self._source = source
        self._commands = commands
        self._duration_s = duration_s
        self.failure: DrivebusError | None = None
        """Reason why the source could not start."""
        self._drives = CellTable("drive", id="drives", cursor_type="row" if commands else "none")
        self._buses = CellTable("bus", id="buses", cursor_type="none")
        self._messages = Static(id="messages", markup=False)
        self._bind_keys()

    def _bind_keys(self) -> None:
        """Bind the keys, described in the user's language; a narrow terminal shows the first ones."""
        stops, others = (
            {"s": "stop", "space": "stop_all"},
            {"r": "run", "plus": "faster", "minus": "slower", "x": "reset"},
        )
        keys = {**stops, "q": "quit", **others} if self._commands else {"q": "quit"}
        for key, action in keys.items():
            shown = {"plus": "+", "minus": "-"}.get(key)
            self.bind(key, action, description=output.text(f"live.key.{action}"), key_display=shown)

    def compose(self) -> ComposeResult:
        yield Static(self._source.title, id="title", markup=False)
        yield self._drives
        select = output.text("live.legend.select") if self._commands else ""
        yield Static(select + output.text("live.legend"), id="legend", markup=False)
        yield self._buses
        yield self._messages
        yield Footer(show_command_palette=False)

    async def on_mount(self) -> None:
        self._set_columns(self.size.width)
        self._buses.can_focus = False
        self._drives.focus()
        try:
            await self._source.start()
        except DrivebusError as error:
            self.failure = error
            self.exit()
            return
        self.set_interval(REFRESH_PERIOD_S, self.refresh_rows)
        if self._duration_s is not None:
            self.set_timer(self._duration_s, self.action_quit)

    async def on_unmount(self) -> None:
        await self._source.close()

    def on_resize(self, event: Resize) -> None:
        self._set_columns(event.size.width)

    def _set_columns(self, cells: int) -> None:
        self._drives.set_columns(drive_columns(cells), self._drive_rows(cells))
        self._buses.set_columns(bus_columns(cells), self._bus_rows(cells))

    def _drive_rows(self, cells: int) -> list[list[Text]]:
        now, columns = self._source.now(), drive_columns(cells)
        return [drive_cells(row, now, columns) for row in self._source.drives()]

    def _bus_rows(self, cells: int) -> list[list[Text]]:
        return [bus_cells(row, bus_columns(cells)) for row in self._source.buses()]

    def refresh_rows(self) -> None:
        """Show the newest rows and messages."""
        cells = self.size.width
        self._drives.update_rows(self._drive_rows(cells))
        self._buses.update_rows(self._bus_rows(cells))
        self._messages.update("\n".join(self._message_lines()))

    def _message_lines(self) -> list[str]:
        """Return the lines of the last whole messages that fit; a long message is continued on the next line."""
        cells = max(1, self._messages.content_size.width - MESSAGE_INDENT)
        height = max(1, self._messages.content_size.height)
        shown: list[str] = []
        for message in reversed(self._source.messages()[-height:]):
            first, *rest = output.wrap(message, cells) or [""]
            lines = [first, *(" " * MESSAGE_INDENT + line for line in rest)]
            if shown and len(shown) + len(lines) > height:
                break
            shown = lines + shown
        return shown[-height:]

    def _selected(self) -> str | None:
        rows = self._source.drives()
        index = self._drives.cursor_row
        return rows[index].key if 0 <= index < len(rows) else None

    def _command(self, name: str, *arguments: float) -> None:
        key = self._selected()
        if self._commands is not None and key is not None:
            getattr(self._commands, name)(key, *arguments)

    def action_help_quit(self) -> None:
        """Quit on Ctrl-C, as every other command does; textual would ask in English."""
        self.exit()

    def action_run(self) -> None:
        self._command("run")

    def action_stop(self) -> None:
        self._command("stop")

    def action_faster(self) -> None:
        self._command("change_frequency", FREQUENCY_STEP_HZ)

    def action_slower(self) -> None:
        self._command("change_frequency", -FREQUENCY_STEP_HZ)

    def action_reset(self) -> None:
        self._command("reset")

    def action_stop_all(self) -> None:
        if self._commands is not None:
            self._commands.stop_all()
