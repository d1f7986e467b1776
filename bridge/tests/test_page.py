"""The live page in a browser: what a person sees and does."""

import asyncio
import contextlib
import itertools
import json
import os
import re
import shutil
from pathlib import Path

import aiohttp
import j2a_bridge
import pytest
from j2a_bridge import web_server
from j2a_bridge.browser import Browser, Page, browser
from j2a_conformance._model import Claims, Run

import j2a

from .support import PATIENCE_S, board_of, bridging, config_for, free_port, served, until

PAGE = Path(j2a_bridge.__file__).parent / "page"
needs_browser = pytest.mark.skipif(
    not (shutil.which("chromium") and (PAGE / "uplot").is_dir())
    and not os.environ.get("J2A_REQUIRE_AVR"),
    reason="needs chromium, and uPlot, which make page fetches",
)


@pytest.fixture(scope="module")
def chromium():
    """A browser for all tests: to start one takes as long as most of them."""
    with asyncio.Runner() as runner:
        running = browser()
        yield runner.run(running.__aenter__())
        runner.run(running.__aexit__(None, None, None))


@pytest.fixture
def blank(chromium: Browser):
    """A context manager that gives an empty page, which shares nothing with those before it."""

    @contextlib.asynccontextmanager
    async def opened():
        async with aiohttp.ClientSession() as session:
            async with session.get(f"{chromium._base}/json/version") as answer:
                address = (await answer.json())["webSocketDebuggerUrl"]
            whole = Page(await session.ws_connect(address))
            context = await whole.ask("Target.createBrowserContext", disposeOnDetach=True)
            target = await whole.ask("Target.createTarget", url="about:blank", **context)
            address = f"{address.partition('/devtools/')[0]}/devtools/page/{target['targetId']}"
            page = Page(await session.ws_connect(address, max_msg_size=0))
            for domain in ("Page", "Runtime", "Log"):
                await page.ask(f"{domain}.enable")
            yield page
            await whole.ask("Target.disposeBrowserContext", **context)

    return opened


@pytest.fixture
def shown(blank):
    """A context manager that gives a page with a board, and the bridge between them."""

    @contextlib.asynccontextmanager
    async def opened(device, width=1280, height=900, **more):
        with served(device) as url:
            async with (
                bridging(config_for(url, sinks=("web", "kept"), **more)) as bridge,
                blank() as page,
            ):
                await until(lambda: bridge._flows)
                await show(page, bridge, width, height)
                yield page, bridge

    return opened


async def show(page, bridge, width, height):
    await page.resize(width, height)
    await page.open(bridge.runners[0].sink.server.url)
    await page.until("document.querySelectorAll('.card').length > 0")
    # Plots show 20 s at first; a busy machine may take as long to draw a value.
    await page.run(
        "(() => { const span = document.getElementById('span');"
        "span.value = '60'; span.dispatchEvent(new Event('change')); })()"
    )


def text_of(name):
    return f"document.querySelector('[aria-label=\"sensor {name}\"]')?.innerText ?? ''"


@needs_browser
def test_values_are_seen_and_a_slider_moves_the_servo(shown):
    async def work():
        device = board_of()
        async with shown(device) as (page, _):

            async def sense_until(script):
                while not await page.run(script):
                    device.sense("quad", 1, 45.5)
                    await asyncio.sleep(0.05)

            await sense_until(f"({text_of('quad')}).includes('45.5 deg')")
            await sense_until(
                "document.querySelector('[aria-label=\"plot of quad\"] canvas') !== null"
            )
            await page.until(f"({text_of('quad')}).includes('per s')")
            await page.run(
                "(() => { const slider = document.getElementById('set-servo-0');"
                "slider.value = '40'; slider.dispatchEvent(new Event('input')); })()"
            )
            await until(lambda: ("servo", 0, 40) in device.was_set)
            # By the keyboard alone.
            await page.run("document.getElementById('set-servo-1').focus()")
            for kind in ("keyDown", "keyUp"):
                await page.ask(
                    "Input.dispatchKeyEvent",
                    type=kind,
                    key="End",
                    code="End",
                    windowsVirtualKeyCode=35,
                )
            await until(lambda: ("servo", 1, 100) in device.was_set)
            assert page.errors == []

    asyncio.run(work())


@needs_browser
def test_a_slider_moves_by_steps_of_the_raw_value(shown):
    text = (
        "ACTUATOR(arm, 0, a, M, 1, i16, none, (unit, rad), (scale, -0.001), (range, -1570, 1570))\n"
        "ACTUATOR(servo, 1, s, M, 1, i8, none, (range, -100, 100))\n"
        "ACTUATOR(gain, 2, g, M, 1, f32, none, (range, -0.5, 0.5))\n"
    )

    async def work():
        device = board_of(text)
        async with shown(device) as (page, _):
            await page.until("document.querySelectorAll('input[type=range]').length === 3")
            for name, value in (("arm", 0.789), ("servo", 7.3), ("gain", 0.123456)):
                await page.run(
                    f"(() => {{ const slider = document.getElementById('set-{name}-0');"
                    f"slider.value = '{value}'; slider.dispatchEvent(new Event('input')); }})()"
                )
            await until(lambda: len(device.was_set) == 3)
        return sorted(device.was_set)

    arm, gain, servo = asyncio.run(work())
    assert arm[2] == pytest.approx(0.789)
    assert gain[2] == pytest.approx(0.123456)
    assert servo[2] == 7


@needs_browser
@pytest.mark.parametrize("kind", ["f32, none", "f32, none, (scale, 0.5)", "i32, 0, (scale, 1e-7)"])
def test_a_slider_shows_the_text_of_a_number_that_the_server_gives(shown, kind):
    async def work():
        device = board_of(f"ACTUATOR(gain, 0, g, M, 1, {kind}, (range, -5, 5))\n")
        async with shown(device) as (page, bridge):
            await (await bridge.client("robot").transducers())["gain"].set(1e-7)
            await page.until("document.querySelector('.slider output').textContent === '1e-07 '")
            assert page.errors == []

    asyncio.run(work())


@needs_browser
def test_a_slider_reaches_its_limits_and_zero_at_any_scale(shown):
    text = (
        "ACTUATOR(odd, 0, o, M, 1, i8, none, (scale, 0.57), (range, 0, 100))\n"
        "ACTUATOR(arm, 1, a, M, 1, i16, none, (scale, 0.1), (range, -3, 3))\n"
    )

    async def work():
        device = board_of(text)
        async with shown(device) as (page, _):
            await page.until("document.querySelectorAll('input[type=range]').length === 2")
            script = (
                "((slider, to) => { slider.value = to; slider.dispatchEvent(new Event('input'));"
                "return slider.value; })"
            )
            found = [
                await page.run(f"{script}(document.getElementById('set-{name}-0'), '{to}')")
                for name, to in (("odd", 1000), ("arm", 1000), ("arm", -1000), ("arm", 0))
            ]
            await until(lambda: {("arm", 0, 0.0)} <= set(device.was_set), device.was_set)
            await until(lambda: any(one[0] == "odd" for one in device.was_set))
        return found, device.was_set

    found, was_set = asyncio.run(work())
    assert found == ["57", "0.3", "-0.3", "0"]
    assert [value for name, _, value in was_set if name == "odd"] == [pytest.approx(57)]


@needs_browser
def test_an_enumeration_is_chosen_by_its_names_whatever_these_are(shown):
    text = (
        "J2A_ENUM(mode, u8, (null, 0), (on, 1), (NaN, 2), (never, 9))\n"
        "ACTUATOR(fan, 0, f, M, 1, mode, 1, (range, 0, 2))\n"
        "ACTUATOR(pump, 1, p, M, 1, mode, none)\n"
    )
    fan = "document.getElementById('set-fan-0')"

    async def work():
        device = board_of(text)
        async with shown(device) as (page, bridge):
            choices = [
                await page.run(
                    f"[...document.getElementById('set-{name}-0').options].map((one) =>one.value)"
                )
                for name in ("fan", "pump")
            ]
            await page.until(f"{fan}.value === 'on'")  # the safe one
            for count, name in enumerate(("NaN", "null")):
                await page.run(f"{fan}.value = '{name}'; {fan}.form.requestSubmit()")
                await until(lambda count=count: len(device.was_set) > count)
            transducers = await bridge.client("robot").transducers()
            await transducers["fan"].set("on")  # by another host
            await page.until(f"{fan}.value === 'on'")
            assert page.errors == []
        return choices, [int(value) for _, _, value in device.was_set]

    choices, was_set = asyncio.run(work())
    assert choices == [["null", "on", "NaN"], ["null", "on", "NaN", "never"]]
    assert was_set == [2, 0, 1]


@needs_browser
def test_names_and_paths_without_a_space_are_wrapped_at_390_pixels(shown):
    model, doc = "M" * 60, "d" * 90

    async def work():
        device = board_of(f'SENSOR(s, 0, s, {model}, 1, u8, none, "{doc}")\n', name="n" * 64)
        async with shown(device, 390, 800) as (page, bridge):
            bridge.runners[0].sink._problem = "no recording: /" + "p" * 100
            await page.until("document.getElementById('told').innerText.includes('ppp')")
            return await page.run("document.documentElement.scrollWidth")

    assert asyncio.run(work()) <= 390


@needs_browser
def test_controls_start_where_the_actuators_are_and_follow_them(shown):
    text = (
        "ACTUATOR(arm, 0, a, M, 2, i16, 100, (unit, rad), (scale, -0.001), (range, -1570, 1570))\n"
        "ACTUATOR(lamp, 1, l, M, 1, bool, none)\n"
        "ACTUATOR(count, 2, c, M, 1, u32, 7)\n"
    )
    script = (
        "JSON.stringify(['arm-0', 'arm-1', 'lamp-0', 'count-0'].map((name) => {"
        "const input = document.getElementById(`set-${name}`);"
        "const shown = input.parentElement.querySelector('output')?.textContent;"
        "return [input.type === 'checkbox' ? input.checked : input.value, shown ?? '']; }))"
    )

    async def work():
        async with shown(board_of(text)) as (page, bridge):

            async def until_it_is(*wanted):
                end = asyncio.get_running_loop().time() + PATIENCE_S
                while (found := json.loads(await page.run(script))) != list(map(list, wanted)):
                    assert asyncio.get_running_loop().time() < end, found
                    await asyncio.sleep(0.1)

            not_set = "-0.1 rad (not set yet)"
            await until_it_is(("-0.1", not_set), ("-0.1", not_set), (False, ""), ("7", ""))
            board = await bridge.client("robot").transducers()
            await board["arm"].set(1.25, channel=1)
            await board["lamp"].set(True)
            await board["count"].set(9)
            await until_it_is(("-0.1", not_set), ("1.25", "1.25 rad"), (True, ""), ("9", ""))
            # What somebody types is not taken away.
            await page.run("document.getElementById('set-count-0').value = '12'")
            await board["count"].set(10)
            await board["lamp"].set(False)
            await until_it_is(("-0.1", not_set), ("1.25", "1.25 rad"), (False, ""), ("12", ""))
            await page.run(
                "(() => { const slider = document.getElementById('set-arm-0');"
                "slider.value = '0.5'; slider.dispatchEvent(new Event('input')); })()"
            )
            await until_it_is(("0.5", "0.5 rad"), ("1.25", "1.25 rad"), (False, ""), ("12", ""))
            assert page.errors == []

    asyncio.run(work())


@needs_browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_at_390_pixels_nothing_is_cut_off(shown, scheme):
    async def work():
        device = board_of(name="a_board_with_a_name_that_is_long")

        @device.function("add_numbers_that_are_large")
        def add(first: j2a.u32, second: j2a.u32) -> j2a.u32:
            return first + second

        async with shown(device, 390, 800) as (page, _):
            await page.prefer(scheme)
            await page.run("document.querySelectorAll('details').forEach((one) => one.open = true)")
            await page.until("document.querySelectorAll('form.call').length > 0")
            width = await page.run("document.documentElement.scrollWidth")
            outside = await page.run(
                "[...document.querySelectorAll('button, input, select, h1, h2, h3, p, li')]"
                ".filter((one) => { const box = one.getBoundingClientRect();"
                "return box.width > 0 && (box.right > 391 || box.left < -1) })"
                ".filter((one) => !one.classList.contains('skip'))"
                ".map((one) => one.outerHTML.slice(0, 80))"
            )
            unnamed = await page.run(
                "[...document.querySelectorAll('button, input, select')].filter((one) =>"
                "!(one.labels?.length || one.textContent.trim() || one.ariaLabel))"
                ".map((one) => one.outerHTML.slice(0, 80))"
            )
        return width, outside, unnamed

    width, outside, unnamed = asyncio.run(work())
    assert width <= 390
    assert outside == []
    assert unnamed == []


@needs_browser
def test_texts_of_boards_are_texts(shown):
    text = 'SENSOR(s, 0, s, M, 1, u8, none, "<img src=x onerror=alert(1)>")\n'

    async def work():
        device = board_of(text, name="<b>robot</b>")
        async with shown(device) as (page, _):
            await page.until("document.body.innerText.includes('onerror=alert')")
            device.debug("<script>window.evil = 1</script>")
            await page.until("document.getElementById('log').innerText.includes('window.evil')")
            assert await page.run(
                "document.querySelectorAll('img, b, script[src=\"\"]').length === 0"
                " || [...document.querySelectorAll('b')]"
                ".every((one) => one.closest('#log'))"
            )
            assert await page.run("window.evil === undefined")

    asyncio.run(work())


@needs_browser
def test_whole_numbers_of_64_bits_keep_their_digits(shown):
    text = (
        "ACTUATOR(count, 0, c, M, 1, u64, none)\n"
        "ACTUATOR(wide, 1, w, M, 1, i64, none, (range, -9007199254740993, 9007199254740993))\n"
        "SENSOR(seen, 2, s, M, 1, u64, none)\n"
    )

    async def work():
        device = board_of(text)

        @device.function("most")
        def most() -> j2a.u64:
            return (1 << 64) - 1

        async with shown(device) as (page, _):
            for name, value in (
                ("count", 9007199254740993),
                ("count", (1 << 64) - 1),
                ("wide", -9007199254740993),
            ):
                await page.run(
                    f"(() => {{ const input = document.getElementById('set-{name}-0');"
                    f"input.value = '{value}'; input.form.requestSubmit(); }})()"
                )
                await until(lambda one=(name, 0, value): one in device.was_set, device.was_set)
            await page.run("document.querySelector('details').open = true")
            await page.until("document.querySelector('form.call') !== null")
            told = "document.querySelector('form.call output').textContent"
            while not (found := await page.run(told)):  # the form may be made anew meanwhile
                await page.run("document.querySelector('form.call').requestSubmit()")
                await asyncio.sleep(0.2)
            assert found == "18446744073709551615"
            while not await page.run(f"({text_of('seen')}).includes('18446744073709551613')"):
                device.sense("seen", 0, 18446744073709551613)
                await asyncio.sleep(0.05)
            assert page.errors == []

    asyncio.run(work())


HARD_TO_DRAW = (
    ("u64", ((1 << 64) - 1,)),
    ("u64", ((1 << 64) - 1, (1 << 64) - 5000)),
    ("i64", (-(1 << 63), (1 << 63) - 1)),
    ("f64", (1.7e308, -1.7e308)),
    ("f64", (5e-324, 0.0)),
    ("f64", (1e99, 1e99 * (1 + 2e-16))),
)


@needs_browser
def test_values_that_are_hard_to_draw_end_no_plots(shown):
    """Each of them would end the plots of the others."""
    text = "".join(
        f"SENSOR(odd{at}, {at}, o{at}, M, 1, {kind}, none)\n"
        for at, (kind, _) in enumerate(HARD_TO_DRAW)
    )
    text += f"SENSOR(other, {len(HARD_TO_DRAW)}, other, M, 1, u8, none)\n"

    async def work():
        device = board_of(text)
        async with shown(device) as (page, _):
            for number in range(30):
                for at, (_, values) in enumerate(HARD_TO_DRAW):
                    device.sense(f"odd{at}", 0, values[number % len(values)])
                device.sense("other", 0, number)
                await asyncio.sleep(0.02)
            for number in (77, 78):
                device.sense("other", 0, number)
                await page.until(f"({text_of('other')}).includes('{number}')")
            for name in ("other", *(f"odd{at}" for at in range(len(HARD_TO_DRAW)))):
                await page.until(
                    f"document.querySelector('[aria-label=\"plot of {name}\"] canvas') !== null"
                )
            assert page.errors == []

    asyncio.run(work())


def drawn(name):
    """Return a script that gives the rows of a plot with the colour of a line, as parts of 1."""
    return (
        "(() => { const canvas ="
        f"  document.querySelector('[aria-label=\"plot of {name}\"] canvas');"
        "if (canvas === null) return [];"
        "const { width, height } = canvas;"
        "const { data } = canvas.getContext('2d').getImageData(0, 0, width, height);"
        "const rows = [];"
        "for (let at = 0; at < data.length; at += 4) {"
        "  const parts = data.slice(at, at + 3);"
        "  const isLine = data[at + 3] > 200 && Math.max(...parts) - Math.min(...parts) > 80;"
        "  if (isLine) rows.push(Math.floor(at / 4 / width) / height);"
        "} return rows; })()"
    )


@needs_browser
def test_a_single_point_is_seen_also_beside_a_channel_with_many(shown):
    text = "SENSOR(once, 0, o, M, 1, u8, none)\nSENSOR(two, 1, two, M, 2, u8, none)\n"

    async def work():
        device = board_of(text)
        async with shown(device) as (page, _):
            device.sense("once", 0, 7)
            await page.until(f"({drawn('once')}).length > 0")
            # The least of the second channel is at the bottom, where the first one never is.
            device.sense("two", 1, 0)
            for number in range(100):
                device.sense("two", 0, 100 + number % 3)
                await asyncio.sleep(0.02)
            await page.until(f"({drawn('two')}).some((row) => row > 0.5)")
            dots = "document.querySelectorAll('[aria-label=\"values of two\"] i').length"
            await page.until(f"{dots} === 2")
            assert page.errors == []

    asyncio.run(work())


@needs_browser
@pytest.mark.parametrize(("value", "low", "high"), [(True, 0, 0.4), (False, 0.6, 1)])
def test_the_axis_of_a_bool_has_nothing_but_false_and_true(shown, value, low, high):
    async def work():
        device = board_of("SENSOR(on, 0, o, M, 1, bool, none)\n")
        async with shown(device) as (page, _):
            device.sense("on", 0, value)
            await asyncio.sleep(0.1)
            device.sense("on", 0, value)
            await page.until(f"({drawn('on')}).length > 0")
            return await page.run(drawn("on"))

    rows = asyncio.run(work())
    assert low <= min(rows)
    assert max(rows) <= high


@needs_browser
@pytest.mark.parametrize(
    ("clock", "told"), [("off", "clock not known"), ("follow", "clock free \u00b1")]
)
def test_what_is_known_of_a_clock_is_told_also_where_that_is_nothing(shown, clock, told):
    async def work():
        async with shown(board_of(), clock=clock) as (page, _):
            await page.until(f"document.querySelector('.about').innerText.includes('{told}')", 30)

    asyncio.run(work())


@needs_browser
def test_a_clock_whose_error_has_no_bound_hides_no_state(shown):
    """While its times do not fit those before; it ended the state of all boards behind it."""

    async def work():
        async with shown(board_of(), clock="follow") as (page, bridge):
            sink = bridge.runners[0].sink
            real = sink.state

            def unbounded():
                state = real()
                for board in state["boards"]:
                    board |= {"clock": "free", "uncertainty_us": "inf"}
                return state

            sink.state = unbounded
            await page.until("document.querySelector('.about').innerText.includes('free ±inf µs')")
            await page.run("document.getElementById('sinks').replaceChildren()")
            await page.until("document.getElementById('sinks').innerText.includes('web: ')")
            del sink.state
            assert page.errors == []

    asyncio.run(work())


@needs_browser
def test_a_problem_stays_and_is_said_once(shown, monkeypatch):
    monkeypatch.setitem(web_server._FILES, "uplot.js", ("uplot/nothing.js", "text/javascript"))
    watched = (
        "(() => { window.count = 0; new MutationObserver(() => window.count++).observe("
        "document.getElementById('told'), { childList: true, characterData: true }); })()"
    )
    told = "(() => { const one = document.getElementById('told');"
    told += "return one.hidden ? '' : one.textContent; })()"

    async def work():
        async with shown(board_of()) as (page, bridge):
            sink = bridge.runners[0].sink
            await page.until("document.getElementById('sinks').innerText.includes('web: ')")
            assert "run make page" in await page.run(told)
            sink._problem = "no recording: a reason"
            await page.until(f"{told} === 'no recording: a reason'")
            await page.run(watched)
            for _ in range(2):
                await page.run("document.getElementById('sinks').replaceChildren()")
                await page.until("document.getElementById('sinks').innerText.includes('web: ')")
            assert await page.run("window.count") == 0
            sink._problem = ""
            await page.until(f"{told}.includes('run make page')")

    asyncio.run(work())


async def reconnect(page, sink):
    """Have the server close a page, and wait until it is back."""

    async def drop():
        for one in list(sink.server._pages):
            await one.end(aiohttp.WSCloseCode.GOING_AWAY)

    asyncio.run_coroutine_threadsafe(drop(), sink._loop)
    await page.until("document.getElementById('link').textContent !== 'connected'")
    await page.until("document.getElementById('link').textContent === 'connected'")


@needs_browser
def test_a_page_too_many_says_so(blank, monkeypatch):
    async def work():
        config = config_for(sinks=("web:0",))
        async with bridging(config) as bridge, blank() as page:
            with monkeypatch.context() as patch:
                patch.setattr(web_server, "_MAX_PAGES", 0)
                await page.open(bridge.runners[0].sink.server.url)
                link = "document.getElementById('link')?.textContent"
                await page.until(f"{link}?.includes('0 pages are open; close one of them')")
            await page.until(f"{link} === 'connected'")

    asyncio.run(work())


@needs_browser
def test_functions_are_asked_for_again_after_a_reconnect(shown, monkeypatch):
    """The board may have become another one meanwhile."""
    orders, asked = web_server._ORDERS, []
    real = orders["functions"]

    async def counted(sink, about):
        asked.append(about)
        return await real(sink, about)

    monkeypatch.setitem(orders, "functions", counted)

    async def work():
        async with shown(board_of()) as (page, bridge):
            await page.until("document.querySelector('.badge').textContent !== ''")
            assert len(asked) == 1
            await reconnect(page, bridge.runners[0].sink)
            async with asyncio.timeout(20):
                await until(lambda: len(asked) == 2)

    asyncio.run(work())


@needs_browser
def test_each_line_of_the_log_is_shown_once_also_after_a_reconnect(shown):
    shown_lines = "document.getElementById('log').innerText.split('once').length - 1"

    async def work():
        async with shown(board_of()) as (page, bridge):
            sink = bridge.runners[0].sink
            sink.note("robot", "x", "once")
            await page.until(f"{shown_lines} > 0")
            await reconnect(page, sink)
            sink.note("robot", "x", "last")
            await page.until("document.getElementById('log').innerText.includes('last')")
            assert await page.run(shown_lines) == 1

    asyncio.run(work())


def tell(bridge, name, values, **series):
    """Have pages told of samples: of each channel times in milliseconds, each before its value."""
    sink = bridge.runners[0].sink
    data = {"v": values, "s": {key[1:]: points for key, points in series.items()}}
    sink._loop.call_soon_threadsafe(sink.server.tell, {"op": "data", "d": {name: data}})


@needs_browser
def test_a_clock_that_went_back_hides_no_channel_behind_one_that_is_not_read(shown):
    async def work():
        async with shown(board_of()) as (page, bridge):
            now, hour = 1_700_000_000_000, 3_600_000
            tell(bridge, "quad", ["1", "1"], c0=[now + hour, 1], c1=[now + hour, 1])
            await page.until(f"({drawn('quad')}).length > 0")
            tell(bridge, "quad", ["4", "1"], c0=[now, 3, now + 1000, 4])
            await page.until(f"({drawn('quad')}).some((row) => row > 0.6)", 10)

    asyncio.run(work())


@needs_browser
def test_what_came_during_a_pause_is_drawn_after_it_also_when_no_more_comes(shown):
    async def work():
        async with shown(board_of()) as (page, bridge):
            await page.run("document.getElementById('pause').click()")
            tell(bridge, "tank/level", ["7"], c0=[1_700_000_000_000, 7])
            await page.until(f"({text_of('tank/level')}).includes('7')")
            assert await page.run(f"({drawn('tank/level')}).length") == 0
            await page.run("document.getElementById('pause').click()")
            await page.until(f"({drawn('tank/level')}).length > 0", 10)

    asyncio.run(work())


@needs_browser
def test_a_structure_has_its_lines_also_where_there_was_none_at_first(shown):
    item = "document.querySelector('[aria-label=\"values of tank/level\"] li')"

    async def work():
        async with shown(board_of()) as (page, bridge):
            tell(bridge, "tank/level", ["none yet"])
            await page.until(f"{item} !== null")
            tell(bridge, "tank/level", ["first  12.5 m\nsecond  13.5 m"])
            await page.until(f"{item}.innerText.split('\\n').length === 2", 10)

    asyncio.run(work())


@needs_browser
def test_lines_of_the_log_have_the_time_of_the_place_as_plots_do(shown):
    async def work():
        async with shown(board_of()) as (page, bridge):
            await page.ask("Emulation.setTimezoneOverride", timezoneId="Asia/Tokyo")
            line = {"t": 1_700_000_000_123, "board": "robot", "kind": "x", "text": "line"}
            sink = bridge.runners[0].sink
            about = {"op": "log", "lines": [line]}
            sink._loop.call_soon_threadsafe(sink.server.tell, about)
            log = "document.getElementById('log').innerText"
            await page.until(f"{log}.includes('line')")
            return await page.run(log)

    assert "07:13:20.123" in asyncio.run(work())  # 22:13:20 UTC


@needs_browser
def test_a_bool_jumps_from_one_value_to_the_other(shown):
    # Columns of the plot with a line between the rows of false and true.
    between = (
        "(() => { const canvas ="
        "  document.querySelector('[aria-label=\"plot of on\"] canvas');"
        "const { width, height } = canvas;"
        "const { data } = canvas.getContext('2d').getImageData(0, 0, width, height);"
        "const columns = new Set();"
        "for (let at = 0; at < data.length; at += 4) {"
        "  const parts = data.slice(at, at + 3), row = at / 4 / width / height;"
        "  const isLine = data[at + 3] > 90 && Math.max(...parts) - Math.min(...parts) > 80;"
        "  if (isLine && row > 0.3 && row < 0.5) columns.add((at / 4) % width);"
        "} return columns.size; })()"
    )

    async def work():
        device = board_of("SENSOR(on, 0, o, M, 1, bool, none)\n")
        async with shown(device) as (page, _):
            device.sense("on", 0, False)
            await page.until(f"({drawn('on')}).some((row) => row > 0.6)")
            await asyncio.sleep(4)  # 20 pixels of a plot of 60 s
            device.sense("on", 0, True)
            await page.until(f"({drawn('on')}).some((row) => row < 0.2)")
            return await page.run(between)

    assert 1 <= asyncio.run(work()) <= 4


@needs_browser
def test_the_marks_of_channels_follow_the_colours_of_the_system(shown):
    script = "getComputedStyle(document.querySelector('.values i')).backgroundColor"

    async def work():
        device = board_of()
        async with shown(device) as (page, _):
            await page.prefer("light")
            device.sense("quad", 0, 90)
            await page.until("document.querySelector('.values i') !== null")
            light = await page.run(script)
            await page.prefer("dark")
            await page.until(f"{script} !== {light!r}", 30)

    asyncio.run(work())


@needs_browser
def test_a_board_that_goes_and_comes_and_a_server_that_does():
    async def work():
        port = free_port()
        web = free_port()
        config = config_for(f"tcp://127.0.0.1:{port}", sinks=(f"web:{web},token=x" + "y" * 30,))
        async with browser() as chromium:
            page = await chromium.page()
            for _ in range(2):
                async with bridging(config) as bridge:
                    await page.open(bridge.runners[0].sink.server.url)
                    for _ in range(2):
                        with served(board_of(serial="1"), port):
                            await page.until("document.querySelectorAll('.card').length === 3")
                            await page.until(
                                "document.querySelector('.state')?.textContent === 'here'"
                            )
                        await page.until(
                            "document.querySelector('.state')?.textContent === 'not here'"
                        )
                await page.until(
                    "document.getElementById('link').textContent.includes('not connected')"
                )

    asyncio.run(work())


@needs_browser
def test_a_state_from_before_the_topics_takes_no_cards_away(shown):
    async def work():
        async with shown(board_of()) as (page, bridge):
            sink = bridge.runners[0].sink
            sink.state = lambda: {"op": "status", "host": "before", "boards": [], "problem": ""}
            await page.until("document.getElementById('host').textContent === 'on before'")
            del sink.state
            await page.until("document.getElementById('host').textContent !== 'on before'")
            await page.until("document.querySelectorAll('section.board .card').length === 3")
            # A board goes with its last topic.
            sink.state = lambda: {"op": "status", "host": "after", "boards": [], "problem": ""}
            for flow in list(bridge._flows.values()):
                bridge._retract(flow)
            await page.until("document.querySelectorAll('section.board').length === 0")
            del sink.state
            assert page.errors == []

    asyncio.run(work())


@needs_browser
@pytest.mark.parametrize("is_tested", [False, True])
def test_the_badge_is_told_as_a_claim_unless_there_is_a_report(shown, is_tested):
    badge = "document.querySelector('.badge')"

    async def work():
        async with shown(board_of()) as (page, bridge):
            properties = await bridge.client("robot").properties()
            if is_tested:
                claims = Claims(mapped=True, functions=(), properties=dict(properties))
                run = Run("tcp://x", "2026-11-25T10:00:00+00:00", 1.0, claims, ())
                bridge.runners[0].sink.reports = [run]
                await page.run("location.reload()")
            wanted = "nothing was tested, tested 2026-11-25" if is_tested else "not checked here"
            await page.until(f"({badge}?.textContent ?? '').includes('{wanted}')")
            return [await page.run(f"{badge}.{one}") for one in ("textContent", "title")]

    text, title = asyncio.run(work())
    assert "claims J2A 1.1 · " in (title if is_tested else text)
    assert ("claims" in text) != is_tested


@needs_browser
def test_functions_are_asked_for_again_after_a_refusal(shown, monkeypatch):
    orders = web_server._ORDERS
    real, count = orders["functions"], itertools.count()

    async def busy_once(sink, about):
        if next(count) == 0:
            raise j2a.LocalError("too many orders wait")
        return await real(sink, about)

    monkeypatch.setitem(orders, "functions", busy_once)

    async def work():
        device = board_of()

        @device.function("add")
        def add(a: j2a.u8) -> j2a.u8:
            return a

        async with shown(device) as (page, _):
            await page.until("document.querySelectorAll('form.call').length > 0")
            assert await page.run("!document.body.textContent.includes('too many orders wait')")

    asyncio.run(work())


@needs_browser
def test_16_channels_at_1_khz_are_thinned_and_memory_does_not_grow(shown):
    text = "SENSOR(fast, 0, fast, M, 16, i16, none)\n"

    async def work():
        device = board_of(text)
        async with shown(device) as (page, bridge):
            sink = bridge.runners[0].sink

            async def sense(count):
                for number in range(count):
                    for channel in range(16):
                        device.sense("fast", channel, (number * (channel + 1)) % 1000, raw=True)
                    if number % 10 == 9:
                        await asyncio.sleep(0.01)

            sizes, points = [], []
            for _ in range(4):
                await sense(1000)
                await page.ask("HeapProfiler.collectGarbage")
                about = await page.ask("Runtime.getHeapUsage")
                sizes.append(about["usedSize"])
                points.append(await page.run("document.querySelectorAll('.plot canvas').length"))
            assert bridge.runners[0].dropped == 0
            assert len(sink._spans) <= 1
            for server_page in sink.server._pages:
                assert server_page._queue.qsize() <= 64
        return sizes, points

    sizes, points = asyncio.run(work())
    assert points[-1] == 1
    # Of 64,000 values each 16 bytes would be a megabyte for each round.
    assert sizes[-1] - sizes[1] < 2_000_000


def luminance(colour):
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [one / 12.92 if one <= 0.04045 else ((one + 0.055) / 1.055) ** 2.4 for one in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one, other):
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_colours_have_the_contrast_of_wcag_aa():
    text = (PAGE / "style.css").read_text()
    light, dark = re.findall(r":root \{(.*?)\}", text, re.DOTALL)
    first = dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", light))
    second = first | dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", dark))
    assert len(first) == len(second) >= 11
    for colours in (first, second):
        for name in ("text", "quiet", "accent", "good", "warn", "bad"):
            for behind in ("page", "card"):
                assert contrast(colours[name], colours[behind]) >= 4.5, (name, behind)
        assert contrast(colours["on-accent"], colours["accent"]) >= 4.5
        assert contrast(colours["field"], colours["card"]) >= 3  # borders of controls


@needs_browser
def test_functions_that_are_asked_for_again_keep_what_is_shown(shown, monkeypatch):
    orders, asked, refused = web_server._ORDERS, [], []
    real = orders["functions"]

    async def counted(sink, about):
        asked.append(about)
        if refused:
            raise j2a.LocalError("too many orders wait")
        return await real(sink, about)

    monkeypatch.setitem(orders, "functions", counted)

    async def work():
        device = board_of()

        @device.function("one")
        def one() -> j2a.u8:
            return 41

        async with shown(device) as (page, _):
            await page.until("document.querySelector('form.call') !== null")
            for is_refused in (False, True):
                refused[:] = [True] * is_refused
                await page.run("(() => { window.form = document.querySelector('form.call'); })()")
                await page.run("document.querySelector('details').open = false")
                await asyncio.sleep(0.1)  # the browser tells several changes at once as one
                before = len(asked)
                await page.run("document.querySelector('details').open = true")
                await until(lambda least=before: len(asked) > least)
                await page.run("window.form.requestSubmit()")  # is answered after it
                await page.until("window.form.querySelector('output').textContent === '41'")
                assert await page.run("window.form.isConnected")

    asyncio.run(work())
