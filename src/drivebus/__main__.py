"""Entry point of the command line: the command ``drivebus`` and ``python -m drivebus``."""

from __future__ import annotations

import signal
import sys

from drivebus.cli.extras import require_extra
from drivebus.cli.output_settings import output_settings
from drivebus.errors import ConfigurationError
from drivebus.i18n import text
from drivebus.terminal import open_missing_streams


def main() -> None:
    """Run the command line; without the packages of the extra ``cli`` print what to install and exit with 2.

    Ctrl-C while it is loaded ends it as later, and says that nothing was sent.
    """
    open_missing_streams()
    language = output_settings(sys.argv[1:]).language
    try:
        require_extra("cli")
    except ConfigurationError as error:
        print(error.text(language), file=sys.stderr)
        sys.exit(2)
    try:
        from drivebus.cli.main import main
    except (KeyboardInterrupt, RuntimeError) as error:
        if not isinstance(error.__cause__ or error, KeyboardInterrupt):  # Python 3.11 wraps that of a class body
            raise
        print(f"\n{text('cli.interrupted_early', language)}", file=sys.stderr)
        sys.exit(128 + signal.SIGINT)

    main()


if __name__ == "__main__":
    main()
