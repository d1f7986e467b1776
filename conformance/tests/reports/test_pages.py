"""The pages: what they hold, that they need nothing else, and how a browser shows them."""

from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from itertools import cycle, pairwise

import pytest
from j2a_conformance import Verdict
from j2a_conformance.reports import _html as html
from j2a_conformance.reports import _matrix as matrix
from j2a_spec import requirements

VOID = {"meta", "link", "img", "br", "input", "wbr"}


class Page(HTMLParser):
    """A page taken apart; an element that is not closed is an error."""

    def __init__(self, data):
        super().__init__()
        self.open, self.elements, self.words = [], [], ""
        self.feed(data.decode())
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.words += data

    def values(self, name):
        return [attrs[name] for _, attrs in self.elements if name in attrs]


def varied(run):
    """Return the run with every verdict but FAILED, and all that the head of a page can say."""
    verdicts = [verdict for verdict in Verdict if verdict is not Verdict.FAILED]
    results = tuple(
        replace(result, verdict=verdict, reason=f"for a {verdict.value} reason", attempts=2)
        for result, verdict in zip(run.results, cycle(verdicts), strict=False)
    )
    stale = ("an entry is stale",)
    return replace(run, results=results, stopped="for once", stale=stale, lossy=3, profile="old")


@pytest.fixture(scope="module", params=["failed", "varied", "matrix"])
def data(request, failed_run, good_run):
    return {
        "failed": lambda: html.render(failed_run),
        "varied": lambda: html.render(varied(good_run)),
        "matrix": lambda: matrix.render([good_run, failed_run, varied(good_run)]),
    }[request.param]()


def test_a_page_is_sound_and_needs_nothing_else(data):
    page = Page(data)
    assert not {tag for tag, _ in page.elements} & {"iframe", "object", "embed", "base"}
    assert [attrs for tag, attrs in page.elements if tag == "script"] == [{}]
    assert not any(name.startswith("on") for _, attrs in page.elements for name in attrs)
    assert not page.values("style")
    assert all(url.startswith("data:") for url in page.values("src"))
    assert all(url.startswith(("#", "data:")) for url in page.values("href"))
    ids = page.values("id")
    assert len(ids) == len(set(ids))
    links = {url[1:] for url in page.values("href") if url.startswith("#")}
    assert links | set(page.values("aria-labelledby")) <= set(ids)
    headings = [int(tag[1]) for tag, _ in page.elements if tag in ("h1", "h2", "h3")]
    assert headings.count(1) == 1
    assert all(after - before <= 1 for before, after in pairwise(headings))
    assert [tag for tag, _ in page.elements].count("main") == 1


def test_the_report_holds_all_of_the_run(failed_run):
    assert {result.verdict for result in failed_run.results} >= {
        Verdict.OK,
        Verdict.FAILED,
        Verdict.UNIMPLEMENTED,
    }
    page = Page(html.render(failed_run))
    words = " ".join(page.words.split())
    for result in failed_run.results:
        for text in (result.case, result.description, result.expectation, result.reason):
            assert " ".join(text.split()) in words
        for name in result.requirements:
            assert f"{name} {requirements.load()[name].text}" in words
            assert name in page.values("id")
    assert failed_run.url in words
    # Failures come first, and what the device says of itself is text.
    assert page.words.index("frame.interrupted") < page.words.index("smoke.answer")
    assert "<script>alert('me')</script>\\x01" in words
    assert '"><img src=x>' in words


def test_bytes_are_annotated_field_by_field(failed_run):
    text = html.render(failed_run).decode()
    layout = text[text.index('id="case-frame.layout"') :]
    layout = layout[: layout.index("</details>")]
    # The reply to an echo of all that is stuffed: pairs are kept together.
    assert '<i class="s">12</i>' in layout
    assert "<u>7d 11</u> <u>7d ec</u> <u>7d 7c</u> 11 ec 7c" in layout
    assert "more \N{HORIZONTAL ELLIPSIS}" in layout
    words = unescape(layout)
    assert "opcode=0xBA length=0xFF checksum right" in words


def test_expected_bytes_stand_beside_those_that_came(failed_run):
    text = html.render(failed_run).decode()
    text = text[text.index('id="case-stuff.replies"') :]
    line = text[text.index('<li class="expected">') :]
    line = line[: line.index("</li>")]
    assert '<i class="p"><mark>55</mark> 41 55</i>' in line
    assert '<i class="o">ba</i>' in line
    assert "a reply with seq" in line


OVERFLOW = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
# The text with the least contrast to what is behind it, by the formula of WCAG 2.
CONTRAST = """
(() => {
  const rgb = (text) => text.match(/[\\d.]+/g).map(Number);
  const light = (color) => {
    const [r, g, b] = color.slice(0, 3).map((v) => v / 255)
      .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = (element) => {
    for (let e = element; e; e = e.parentElement) {
      const color = rgb(getComputedStyle(e).backgroundColor);
      if (color.length === 3 || color[3] > 0) return color;
    }
    throw new Error("the page has no background");
  };
  let worst = [99, "", 0];
  for (const e of document.querySelectorAll("body *")) {
    const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
    if (!own || !e.checkVisibility()) continue;
    const both = [light(rgb(getComputedStyle(e).color)), light(behind(e))];
    const ratio = (Math.max(...both) + 0.05) / (Math.min(...both) + 0.05);
    worst[2] += 1;
    if (ratio < worst[0]) worst = [ratio, e.outerHTML.slice(0, 99), worst[2]];
  }
  return worst;
})()
"""
OPEN_ALL = "for (const e of document.querySelectorAll('details')) e.open = true"
COUNT = "document.querySelectorAll('.case:not([hidden])').length"


@pytest.fixture
def file(data, tmp_path):
    path = tmp_path / "page.html"
    path.write_bytes(data)
    return path.as_uri()


def complaints(browser, url):
    """Return what the browser wrote to its console or loaded beside the page itself."""
    found = []
    for event in browser.events:
        params = event["params"]
        if event["method"] in ("Log.entryAdded", "Runtime.consoleAPICalled"):
            found.append(params)
        elif event["method"] == "Runtime.exceptionThrown":
            found.append(params["exceptionDetails"])
        elif event["method"] == "Network.requestWillBeSent":
            address = params["request"]["url"]
            if address != url and not address.startswith("data:"):
                found.append(address)
    return found


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_in_a_browser(browser, file, width, scheme):
    browser.show(file, width, scheme=scheme)
    browser.value(OPEN_ALL)
    assert browser.value("innerWidth") == width
    assert browser.value(OVERFLOW) == 0
    ratio, where, count = browser.value(CONTRAST)
    assert count > 100
    assert ratio >= 4.5, where
    dark = browser.value("getComputedStyle(document.body).backgroundColor") == "rgb(20, 23, 27)"
    assert dark == (scheme == "dark")
    assert complaints(browser, file) == []


PLACES = """
(() => {
  const box = document.querySelector(".scroll");
  box.scrollTo(200, 150);
  const at = (words) => box.querySelector(words).getBoundingClientRect();
  const inner = box.getBoundingClientRect();
  const name = at("tbody:last-child tr:last-child th");
  return {
    more: box.scrollWidth - box.clientWidth,
    moved: [box.scrollLeft, box.scrollTop],
    name: name.left - inner.left,
    head: at("thead th").top - inner.top,
    corner: [at("thead td").left - inner.left, at("thead td").top - inner.top],
    share: [name.width / inner.width, inner.height / innerHeight],
    behind: getComputedStyle(box).backgroundImage,
  };
})()
"""


@pytest.mark.parametrize("width", [390, 1280])
def test_nine_runs_side_by_side(browser, failed_run, good_run, tmp_path, width):
    title = "A device with a title as long as titles are, at 115200 baud"
    runs = [replace(run, title=title) for run in (good_run, failed_run, good_run) * 3]
    path = tmp_path / "matrix.html"
    path.write_bytes(matrix.render(runs))
    browser.show(path.as_uri(), width, 500)
    assert browser.value(OVERFLOW) == 0
    assert "9 runs; where it is wider" in browser.value("document.body.innerText")
    places = browser.value(PLACES)
    assert places["more"] > 200
    assert places["moved"] == [200, 150]
    # Whatever is scrolled, the names of cases and of runs are where they were.
    assert (places["name"], places["head"], places["corner"]) == (0, 0, [0, 0])
    assert places["share"][0] < 0.5
    assert places["share"][1] <= 0.9
    assert "gradient" in places["behind"]


@pytest.fixture
def report(browser, failed_run, tmp_path):
    path = tmp_path / "report.html"
    path.write_bytes(html.render(failed_run))
    browser.show(path.as_uri(), 1280)
    return browser


def test_the_filter(report, failed_run):
    total = len(failed_run.results)
    assert report.value(COUNT) == total
    report.value(
        "(() => { const e = document.querySelector('[type=search]'); e.value = 'J2A-FRAME-007';"
        " e.dispatchEvent(new Event('input', {bubbles: true})) })()"
    )
    wanted = [r for r in failed_run.results if "J2A-FRAME-007" in r.requirements]
    assert report.value(COUNT) == len(wanted) < total
    assert report.value("document.querySelector('output').value").startswith(f"{len(wanted)} of ")
    report.value("document.querySelector('[value=failed]').click()")
    rest = [result for result in wanted if result.verdict is not Verdict.FAILED]
    assert report.value(COUNT) == len(rest)


def test_a_link_opens_its_case(report):
    case = "document.getElementById('case-frame.layout').closest('details')"
    assert report.value(f"{case}.open") is False
    opened = report.value(
        f"new Promise((done) => {{ {case}.addEventListener('toggle', () => done({case}.open));"
        " document.querySelector('a[href=\"#case-frame.layout\"]').click() })"
    )
    assert opened is True


def test_without_scripts_all_is_there(browser, file):
    browser.ask("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.show(file, 1280)
        assert browser.value(COUNT) > 0
        form = "document.querySelector('form')"
        assert browser.value(f"{form} === null || !{form}.checkVisibility()")
    finally:
        browser.ask("Emulation.setScriptExecutionDisabled", value=False)
