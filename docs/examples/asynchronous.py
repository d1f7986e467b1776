"""The same client for asyncio. Takes the URL of a device with the demo functions."""

import asyncio
import sys

import j2a


async def main(url: str) -> None:
    """Make two calls at once; each waits for its own reply."""
    async with await j2a.aconnect(url) as board:
        slow = board.functions.delay(200)
        quick = board.functions.add(40, 2)
        print(await asyncio.gather(slow, quick))


if len(sys.argv) != 2:
    sys.exit(f"usage: python {sys.argv[0]} URL")
asyncio.run(main(sys.argv[1]))
