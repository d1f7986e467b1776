"""The same client for asyncio. Takes the URL of a device with the demo functions."""

import asyncio
import sys

import j2a


async def main(url: str) -> None:
    """Make two calls at once; each waits for its own reply."""
    async with await j2a.aconnect(url) as board:
        slow = board.call("delay", (200).to_bytes(2, "little"))
        quick = board.call("a2jEcho", b"hello")
        replies = await asyncio.gather(slow, quick)
        print([reply.code for reply in replies])


asyncio.run(main(sys.argv[1]))
