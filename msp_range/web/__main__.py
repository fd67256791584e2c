"""The page's process: ``python -m msp_range.web [HOST:]PORT --socket PATH``.

`msp-range run --web` starts it, and for the service systemd does (systemd/msp-range-web.service).
"""

import argparse
import asyncio
import sys
from functools import partial
from pathlib import Path

from msp_range.log import Log
from msp_range.systemd import notify_systemd
from msp_range.watch.place import parse_listen
from msp_range.web.access import token_for
from msp_range.web.server import Page
from msp_range.yaml_file import ConfigError


def main() -> int:
    """Serve until standard input ends, as with the bridge, or a signal arrives."""
    parser = argparse.ArgumentParser(prog="python -m msp_range.web")
    parser.add_argument("listen", metavar="[HOST:]PORT")
    parser.add_argument("--socket", type=Path, required=True)
    parser.add_argument("--unit", help="systemd's unit of the bridge, to show why it does not run")
    parser.add_argument("--log", choices=["text", "json"], default="text")
    options = parser.parse_args()
    log = Log(options.log)
    try:
        listen = parse_listen(options.listen)
        page = Page(options.socket, token_for(listen), options.unit)
        asyncio.run(page.serve(listen, partial(_on_ready, log)))
    except KeyboardInterrupt:
        pass
    except (ConfigError, OSError) as error:
        log.error("web page", listen=options.listen, error=str(error))
        return 1
    return 0


def _on_ready(log: Log, url: str) -> None:
    log.info("web page", url=url)
    notify_systemd("READY=1")


if __name__ == "__main__":
    sys.exit(main())
