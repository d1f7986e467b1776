// The live page: shows what the server tells over a WebSocket, and sends orders back.
// Rules: texts come from boards, so none is ever taken as HTML; a plot keeps a bounded number of points; what is
// drawn follows the frames of the screen, however much comes.

const POINTS = 6000;
const GREATEST = 1e100; // what is greater is shown as a value, and not drawn
const COLOURS = 8;
const SPARSE = 30; // so few points are seen as such: a line needs two
const byId = (id) => document.getElementById(id);
const topics = new Map();
const boards = new Map();
let socket = null;
let uPlot = null;
let nextId = 1;
let isPaused = false;
let spanS = 20;
let noPlots = "";
let newestLine = 0;
const answers = new Map();

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "class") element.className = value;
    else if (name in element && typeof value !== "string") element[name] = value;
    else element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

function told(problem) {
  const text = problem || noPlots;
  if (byId("told").textContent === text) return; // a screen reader would say it with each state
  byId("told").textContent = text;
  byId("told").hidden = !text;
}

// ---------------------------------------------------------------------- the server

function connect() {
  const where = new URL("ws", location.href);
  where.protocol = "ws:";
  socket = new WebSocket(where);
  socket.addEventListener("open", () => {
    link("connected");
    for (const board of boards.values()) board.isKnown = false; // it may have become another one meanwhile
  });
  socket.addEventListener("message", (event) => take(JSON.parse(event.data)));
  socket.addEventListener("close", () => {
    link("not connected; trying again");
    tellRefusal();
    for (const answer of answers.values()) answer({ ok: false, message: "the connection was lost" });
    answers.clear();
    setTimeout(connect, 1000);
  });
}

async function tellRefusal() {
  // Why a WebSocket is refused no browser tells; the server says it to an ordinary request.
  const answer = await fetch("ws").catch(() => null);
  if (answer?.status !== 503) return;
  const text = await answer.text();
  if (socket.readyState !== WebSocket.OPEN) link(`not connected: ${text}; trying again`);
}

function link(text) {
  byId("link").textContent = text;
}

function order(about) {
  return new Promise((resolve) => {
    const id = nextId++;
    if (socket === null || socket.readyState !== WebSocket.OPEN) {
      resolve({ ok: false, message: "not connected" });
      return;
    }
    answers.set(id, resolve);
    socket.send(JSON.stringify({ ...about, id }));
  });
}

function take(about) {
  if (about.op === "topics") takeTopics(about.topics);
  else if (about.op === "data") takeData(about.d);
  else if (about.op === "actuators") takeActuators(about.d);
  else if (about.op === "status") takeStatus(about);
  else if (about.op === "log") takeLog(about);
  else if (about.op === "answer") {
    answers.get(about.id)?.(about);
    answers.delete(about.id);
  }
}

// ---------------------------------------------------------------------- boards and topics

function boardOf(name) {
  let board = boards.get(name);
  if (board === undefined) {
    const state = make("span", { class: "state" });
    const facts = make("p");
    const badges = make("span", { class: "badge", hidden: true });
    const cards = make("div", { class: "cards" });
    const list = make("div");
    const functions = make("details", {}, make("summary", {}, "Functions"), list);
    const element = make(
      "section",
      { class: "board", "aria-label": `board ${name}` },
      make("div", { class: "about" }, make("h2", {}, name), state, facts, badges),
      cards,
      functions,
    );
    board = { name, element, state, facts, badges, cards, list, functions, isKnown: false, forms: "" };
    functions.addEventListener("toggle", () => functions.open && learn(board));
    boards.set(name, board);
    byId("boards").append(element);
  }
  return board;
}

function takeTopics(all) {
  for (const [name, topic] of topics) {
    const now = all[name];
    if (now === undefined || JSON.stringify(now) !== topic.text) {
      topic.plot?.destroy();
      topic.element.remove();
      topics.delete(name);
    }
  }
  for (const [name, about] of Object.entries(all)) {
    if (!topics.has(name)) {
      const topic = about.kind === "sensor" ? sensorCard(name, about) : actuatorCard(name, about);
      topic.text = JSON.stringify(about);
      topic.board = about.board;
      topics.set(name, topic);
      boardOf(about.board).cards.append(topic.element);
    }
  }
  drawEmpty();
}

function drawEmpty() {
  byId("none").hidden = boards.size > 0;
}

function takeStatus(about) {
  byId("host").textContent = about.host ? `on ${about.host}` : "";
  const record = byId("record");
  record.setAttribute("aria-pressed", String(Boolean(about.recording)));
  record.textContent = about.recording ? "Stop recording" : "Record";
  record.title = about.recording ?? "Write all samples into an MCAP file";
  told(about.problem);
  const seen = new Set();
  for (const status of about.boards ?? []) {
    const name = status.name || status.url;
    seen.add(name);
    const board = boardOf(name);
    board.state.textContent = status.is_here ? "here" : "not here";
    board.state.className = `state ${status.is_here ? "here" : "gone"}`;
    const parts = [status.url];
    if (status.clock) {
      const known = status.uncertainty_us === null ? "" : ` ±${short(status.uncertainty_us)} µs`;
      parts.push(`clock ${status.clock}${known}`);
    } else if (status.is_here) {
      parts.push("clock not known");
    }
    if (status.problem) parts.push(status.problem);
    board.facts.textContent = parts.join(" · ");
    for (const one of status.topics) showRate(one);
    if (status.is_here && !board.isKnown) learn(board);
    if (!status.is_here) board.isKnown = false;
    board.functions.hidden = !status.is_here;
  }
  // The topics of a board may come before the state that has it.
  for (const topic of topics.values()) seen.add(topic.board);
  for (const [name, board] of boards) {
    if (!seen.has(name) && about.boards) {
      board.element.remove();
      boards.delete(name);
    }
  }
  drawEmpty();
  byId("sinks").replaceChildren(
    ...(about.sinks ?? []).map((sink) => {
      const samples = sink.published === 1 ? "sample" : "samples";
      const text = `${sink.name}: ${sink.published} ${samples}, ${sink.dropped} dropped`;
      const item = make("li", {}, text);
      if (sink.problem) item.append(" · ", make("span", { class: "bad" }, sink.problem));
      return item;
    }),
  );
}

function showRate(status) {
  const topic = topics.get(status.name);
  if (topic?.rate === undefined) return;
  const latency = status.latency_ms === null ? "" : `${status.latency_ms.toFixed(2)} ms`;
  const lost = make("span", status.lost ? { class: "bad" } : {}, `${status.lost} lost`);
  topic.rate.replaceChildren(
    make("span", {}, `${status.rate_hz.toFixed(1)} per s`),
    make("span", { title: "from the measurement to its arrival" }, latency),
    lost,
  );
}

function short(number) {
  if (typeof number !== "number") return number; // "inf": the times of a clock do not fit those before
  return number >= 100 ? number.toFixed(0) : number.toFixed(1);
}

function head(name, about) {
  const channels = about.channels > 1 ? `${about.channels} × ` : "";
  return make(
    "div",
    { class: "head" },
    make("h3", {}, name),
    make("small", {}, `${channels}${about.type}${about.model ? ` · ${about.model}` : ""}`),
  );
}

// ---------------------------------------------------------------------- sensors

function sensorCard(name, about) {
  const values = make("ul", { class: "values", "aria-label": `values of ${name}` });
  const plot = make("div", { class: "plot", role: "img", "aria-label": `plot of ${name}` });
  const rate = make("div", { class: "facts" });
  const element = make("article", { class: "card", "aria-label": `sensor ${name}` }, head(name, about));
  if (about.doc) element.append(make("small", {}, about.doc));
  element.append(values, plot, rate);
  const isBool = about.type.split(" ")[0] === "bool";
  return { element, values, where: plot, rate, isBool, series: new Map(), text: "", isDirty: false };
}

function takeData(all) {
  for (const [name, data] of Object.entries(all)) {
    const topic = topics.get(name);
    if (topic?.values === undefined) continue;
    topic.newest = data.v;
    topic.isDirty = true;
    for (const [series, flat] of Object.entries(data.s)) {
      let points = topic.series.get(series);
      if (points === undefined) {
        if (topic.series.size >= 32) continue;
        points = { times: [], values: [] };
        topic.series.set(series, points);
        topic.isNew = true;
      }
      for (let at = 0; at < flat.length; at += 2) {
        // A clock that went back begins the plot anew, as its times mean something else: also those of channels that
        // were not read since, which would hold the axis in the future.
        if (flat[at] < points.times.at(-1) - 1000) {
          for (const one of topic.series.values()) one.times.length = one.values.length = 0;
        }
        points.times.push(flat[at]);
        points.values.push(Math.abs(flat[at + 1]) <= GREATEST ? flat[at + 1] : null);
      }
      const tooMany = points.times.length - POINTS;
      if (tooMany > POINTS / 10) {
        points.times.splice(0, tooMany);
        points.values.splice(0, tooMany);
      }
    }
  }
}

function draw() {
  for (const topic of topics.values()) {
    if (!topic.isDirty) continue;
    topic.isDirty = false;
    drawValues(topic);
    if (isPaused) continue;
    try {
      drawPlot(topic);
    } catch {
      // What one board measures must not end the plots of all: this one begins anew.
      topic.plot?.destroy();
      topic.plot = undefined;
      topic.series.clear();
    }
  }
  requestAnimationFrame(draw);
}

function drawValues(topic) {
  const items = topic.values.children;
  if (items.length > 0 && items.length < topic.newest.length) topic.values.replaceChildren();
  topic.newest.forEach((text, at) => {
    if (items[at] === undefined) {
      const name = make("small", {}, topic.newest.length > 1 ? `channel ${at}` : "");
      topic.values.append(make("li", {}, name, make("span")));
    }
    const name = items[at].firstElementChild;
    if (topic.newest.length > 1 && name.firstElementChild === null) {
      const series = [...topic.series.keys()].indexOf(String(at));
      if (series >= 0) name.prepend(dot(series)); // a channel may be read later than the others
    }
    const value = items[at].lastElementChild;
    if (value.textContent === text) return;
    value.textContent = text;
    if (text.length > 20) items[at].className = "wide"; // it may have been "none yet" at first
  });
}

function drawPlot(topic) {
  if (uPlot === null || topic.series.size === 0) return;
  const names = [...topic.series.keys()];
  if (topic.plot === undefined || topic.isNew) {
    topic.plot?.destroy();
    topic.plot = newPlot(topic, names);
    topic.isNew = false;
  }
  const end = Math.max(...names.map((name) => topic.series.get(name).times.at(-1) ?? 0));
  const begin = end - spanS * 1000;
  // Channels have times of their own: uPlot wants one axis, with gaps for the others.
  const parts = names.map((name) => {
    const { times, values } = topic.series.get(name);
    let from = times.length;
    while (from > 0 && times[from - 1] >= begin) from--;
    return [times.slice(from).map((one) => one / 1000), values.slice(from)];
  });
  const data = parts.length === 1 ? parts[0] : uPlot.join(parts);
  topic.plot.batch(() => {
    topic.plot.setData(data, false);
    topic.plot.setScale("x", { min: begin / 1000, max: end / 1000 });
  });
}

function hue(at) {
  return (205 + 137 * (at % COLOURS)) % 360;
}

function colour(at) {
  const style = getComputedStyle(document.documentElement);
  return `hsl(${hue(at)} 70% ${style.getPropertyValue("--curve")})`;
}

function dot(series) {
  const element = make("i", { "aria-hidden": "true" });
  element.style.background = `hsl(${hue(series)} 70% var(--curve))`; // follows the colours of the system
  return element;
}

// Without a range of its own a constant would be drawn as a line of noise, and what differs in the last digits alone has
// no ticks between.
function around(low, high) {
  const least = Math.max(Math.abs(low), Math.abs(high)) * 1e-9;
  if (high - low > least) return uPlot.rangeNum(low, high, 0.1, true);
  const margin = Math.max(1, 10 * least);
  return [low - margin, high + margin];
}

// Of one series, as others may have many points between its own.
function isSparse(plot, series, from, to) {
  let count = 0;
  for (let at = from; at <= to && count <= SPARSE; at++) count += plot.data[series][at] != null;
  return count <= SPARSE;
}

const TRUTH = { incrs: [1], values: (plot, ticks) => ticks.map((one) => String(one === 1)) };

function newPlot(topic, names) {
  const style = getComputedStyle(document.documentElement);
  const axis = {
    stroke: style.getPropertyValue("--quiet"),
    grid: { stroke: style.getPropertyValue("--line"), width: 1 },
    ticks: { stroke: style.getPropertyValue("--line"), width: 1 },
    font: "11px system-ui",
  };
  const series = names.map((name, at) => ({
    label: name,
    stroke: colour(at),
    width: 1.5,
    spanGaps: true,
    points: { size: 5, fill: colour(at), show: isSparse },
    // Between two readings a bool is what it was: a slope would be read as neither.
    ...(topic.isBool ? { paths: uPlot.paths.stepped({ align: 1 }) } : {}),
  }));
  return new uPlot(
    {
      width: topic.where.clientWidth || 300,
      height: 150,
      pxAlign: 0,
      cursor: { show: false },
      legend: { show: false },
      scales: {
        x: { auto: false },
        y: { range: topic.isBool ? [-0.1, 1.1] : (plot, low, high) => around(low, high) },
      },
      axes: [{ ...axis, size: 26 }, { ...axis, size: 52, ...(topic.isBool ? TRUTH : {}) }],
      series: [{}, ...series],
    },
    [[], ...names.map(() => [])],
    topic.where,
  );
}

// ---------------------------------------------------------------------- actuators

function actuatorCard(name, about) {
  const element = make("article", { class: "card", "aria-label": `actuator ${name}` }, head(name, about));
  if (about.doc) element.append(make("small", {}, about.doc));
  const answer = make("output", { role: "status" });
  const controls = [];
  const topic = { element, controls, orders: 0 };
  const send = async (text, channel) => {
    topic.orders++;
    // As a text a number has all its digits; names such as null and NaN are no values of JSON.
    const what = about.choices ? { values: [text] } : { text };
    const reply = await order({ op: "set", topic: name, ...what, channel });
    answer.className = reply.ok ? "good" : "bad";
    answer.textContent = reply.ok ? "set" : reply.message;
    topic.orders--;
  };
  for (let channel = 0; channel < about.channels; channel++) {
    controls.push(control(name, about, channel, send));
    element.append(controls[channel].element);
  }
  element.append(answer);
  return topic;
}

function takeActuators(all) {
  for (const [name, values] of Object.entries(all)) {
    const topic = topics.get(name);
    // What was read before an order was answered would move a slider back; it is read again then.
    if (topic?.controls === undefined || topic.orders) continue;
    values.forEach((value, channel) => topic.controls[channel]?.take(value.text, value.is_set));
  }
}

function control(name, about, channel, send) {
  const id = `set-${name}-${channel}`;
  const label = make("label", { for: id }, about.channels > 1 ? `channel ${channel}` : "value");
  const type = about.type.split(" ")[0];
  if (type === "bool") {
    const input = make("input", { id, type: "checkbox", role: "switch" });
    input.addEventListener("change", () => send(String(input.checked), channel));
    const take = (text) => {
      if (text !== null) input.checked = text === "true";
    };
    return { element: make("div", { class: "slider" }, label, input), take };
  }
  const range = about.range;
  // Whole numbers that are greater cannot be told apart here, so a slider would miss them.
  const isExact = type[0] === "f" || range?.every((end) => Number.isSafeInteger(Math.round(end)));
  if (about.choices || !range || !isExact || typeof range[0] !== "number" || typeof range[1] !== "number") {
    const input = about.choices
      ? make("select", { id }, ...about.choices.map((choice) => make("option", {}, choice)))
      : make("input", { id, type: "text", placeholder: type, autocomplete: "off" });
    if (about.choices) input.selectedIndex = -1; // none is set yet
    const form = make("form", {}, input, make("button", {}, "Set"));
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      told = input.value;
      send(input.value, channel);
    });
    let told = "";
    const take = (text) => {
      if (text === null || input.value !== told) return; // somebody types
      input.value = text;
      told = input.value; // "" where it is none of the choices
    };
    return { element: make("div", { class: "slider" }, label, form), take };
  }
  const [low, high] = [Math.min(...range), Math.max(...range)];
  const input = make("input", {
    id,
    type: "range",
    min: String(low),
    max: String(high),
    step: String(about.step),
    value: String(Math.min(high, Math.max(low, 0))),
  });
  const shown = make("output", { for: id });
  const show = (text = String(Number(input.value)), more = "") => {
    shown.textContent = `${text} ${about.unit}${more}`;
  };
  show();
  // While it is dragged, an order goes out when the one before was answered.
  let isBusy = false;
  let isWanted = false;
  const push = async () => {
    isWanted = true;
    if (isBusy) return;
    isBusy = true;
    while (isWanted) {
      isWanted = false;
      await send(String(Number(input.value)), channel);
    }
    isBusy = false;
  };
  input.addEventListener("input", () => {
    show();
    push();
  });
  const take = (text, isSet) => {
    if (text !== null) input.value = text;
    // A browser writes some numbers in another way, such as 1e-7, and shows none beyond the range.
    show(text ?? undefined, isSet ? "" : " (not set yet)");
  };
  return { element: make("div", { class: "slider" }, label, shown, input), take };
}

// ---------------------------------------------------------------------- functions

async function learn(board) {
  board.isKnown = true;
  const reply = await order({ op: "functions", board: board.name });
  if (!reply.ok) {
    board.isKnown = false; // the next state asks again
    if (!board.forms) board.list.replaceChildren(make("output", { class: "bad" }, reply.message));
    return;
  }
  const { functions, properties, capabilities, report } = reply.result;
  const claims = [properties["j2a.spec"] ? `J2A ${properties["j2a.spec"]}` : "J2A 1.0", ...capabilities];
  const claimed = `claims ${claims.join(" · ")}`;
  board.badges.textContent = report ? report.text : `${claimed}; not checked here`;
  board.badges.title = report
    ? `of a report of a board with the same properties; this one ${claimed}`
    : "j2a-conform checks it, and j2a view --report FILE shows what it found";
  board.badges.classList.toggle("good", ["ok", "known-deviation"].includes(report?.tone));
  board.badges.classList.toggle("bad", report?.tone === "failed");
  board.badges.hidden = false;
  // New forms would take away what was typed, and the results that are shown.
  const forms = JSON.stringify(functions);
  if (forms === board.forms) return;
  board.forms = forms;
  const known = functions.filter((one) => one.parameters !== null);
  const others = functions.filter((one) => one.parameters === null).map((one) => one.name);
  board.list.replaceChildren(...known.map((one) => functionForm(board.name, one)));
  if (others.length) board.list.append(make("p", {}, `These do not say what they take: ${others.join(", ")}.`));
}

function functionForm(board, about) {
  const name = make("div", { class: "name" }, make("code", {}, `${about.name}${about.signature}`));
  if (about.doc) name.append(make("small", {}, ` ${about.doc}`));
  const form = make("form", { class: "call" }, name);
  const fields = about.parameters.map((one, at) => {
    const id = `call-${board}-${about.name}-${at}`;
    const input = one.choices
      ? make("select", { id }, ...one.choices.map((choice) => make("option", {}, choice)))
      : one.kind === "bool"
        ? make("select", { id }, make("option", {}, "false"), make("option", {}, "true"))
        : make("input", { id, type: "text", autocomplete: "off", placeholder: one.type });
    form.append(make("div", {}, make("label", { for: id }, `${one.name} ${one.unit}`.trim() || "value"), input));
    return input;
  });
  const result = make("output", { role: "status" });
  form.append(make("button", {}, "Call"), result);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    result.textContent = "";
    const words = fields.map((input) => input.value);
    const reply = await order({ op: "call", board, function: about.name, words });
    result.className = reply.ok ? "good" : "bad";
    result.textContent = !reply.ok ? reply.message : reply.result === null ? "done" : reply.text;
  });
  return form;
}

// ---------------------------------------------------------------------- the log

function takeLog({ lines, is_all: isAll }) {
  const log = byId("log");
  if (isAll) {
    log.replaceChildren();
    newestLine = 0;
  }
  const isAtEnd = log.scrollTop + log.clientHeight >= log.scrollHeight - 4;
  for (const line of lines) {
    if (line.number <= newestLine) continue; // it was among all lines already
    newestLine = line.number ?? newestLine;
    // As the axes of the plots: in the time of this place.
    const offset = new Date(line.t).getTimezoneOffset();
    const time = new Date(line.t - offset * 60_000).toISOString().slice(11, 23);
    log.append(make("li", {}, make("time", {}, time), make("b", {}, `${line.board} ${line.kind}`), line.text));
  }
  while (log.children.length > 200) log.firstElementChild.remove();
  if (isAtEnd) log.scrollTop = log.scrollHeight;
}

// ---------------------------------------------------------------------- begin

byId("span").addEventListener("change", (event) => {
  spanS = Number(event.target.value);
  anew();
});
byId("pause").addEventListener("click", (event) => {
  isPaused = !isPaused;
  event.target.setAttribute("aria-pressed", String(isPaused));
  event.target.textContent = isPaused ? "Go on" : "Pause";
  anew(); // also what has sent nothing since
});
byId("record").addEventListener("click", async (event) => {
  const isOn = event.target.getAttribute("aria-pressed") === "true";
  const reply = await order({ op: "record", on: !isOn });
  if (!reply.ok) told(reply.message);
});
const anew = () => {
  for (const topic of topics.values()) {
    if (topic.newest) topic.isNew = topic.isDirty = true;
  }
};
addEventListener("resize", anew);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", anew);
try {
  uPlot = (await import("./uplot.js")).default;
} catch {
  noPlots = "Plots need uPlot, which is missing in this installation: run make page. Values are shown all the same.";
  told("");
}
connect();
requestAnimationFrame(draw);
