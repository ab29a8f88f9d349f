"""Entry point of the command line: the command ``drivebus`` and ``python -m drivebus``."""

from __future__ import annotations

import sys
from collections.abc import Callable

from drivebus.cli.early_interrupt import end_interrupt_on_sigterm, interrupt_on_sigterm, is_early_interrupt


def main() -> None:
    """Run the command line; without the packages of the extra ``cli`` print what to install and exit with 2.

    Ctrl-C or SIGTERM while it is loaded ends it as Ctrl-C does later, and says that nothing was sent.
    """
    try:
        interrupt_on_sigterm()
        command_line = _load()
    except (KeyboardInterrupt, RuntimeError) as error:
        if not is_early_interrupt(error):
            raise
        end_interrupt_on_sigterm()
        import signal

        from drivebus.cli.output_settings import output_settings
        from drivebus.i18n import text

        print(f"\n{text('cli.interrupted_early', output_settings(sys.argv[1:]).language)}", file=sys.stderr)
        sys.exit(128 + signal.SIGINT)

    command_line()


def _load() -> Callable[[], None]:
    """Import the command line: a second in which Ctrl-C may come."""
    from drivebus.cli.extras import require_extra
    from drivebus.errors import ConfigurationError
    from drivebus.terminal import open_missing_streams

    open_missing_streams()
    try:
        require_extra("cli")
    except ConfigurationError as error:
        from drivebus.cli.output_settings import output_settings

        print(error.text(output_settings(sys.argv[1:]).language), file=sys.stderr)
        sys.exit(2)
    from drivebus.cli.main import main

    return main


if __name__ == "__main__":
    main()
