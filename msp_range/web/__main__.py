"""The page's process: ``python -m msp_range.web [HOST:]PORT --socket PATH``; `msp-range run --web` starts it."""

import argparse
import asyncio
import sys
from pathlib import Path

from msp_range.log import Log
from msp_range.watch.place import parse_listen
from msp_range.web.access import token_for
from msp_range.web.server import Page
from msp_range.yaml_file import ConfigError


def main() -> int:
    """Serve until standard input ends, as with the bridge, or a signal arrives."""
    parser = argparse.ArgumentParser(prog="python -m msp_range.web")
    parser.add_argument("listen", metavar="[HOST:]PORT")
    parser.add_argument("--socket", type=Path, required=True)
    parser.add_argument("--log", choices=["text", "json"], default="text")
    options = parser.parse_args()
    log = Log(options.log)
    try:
        listen = parse_listen(options.listen)
        page = Page(options.socket, token_for(listen))
        asyncio.run(page.serve(listen, lambda url: log.info("web page", url=url)))
    except KeyboardInterrupt:
        pass
    except (ConfigError, OSError) as error:
        log.error("web page", listen=options.listen, error=str(error))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
