"use strict";
// Draws the figures of a report. What they consist of is in the payload (bench/report/drawing.py);
// here it is unpacked, reduced to what the pixels can show, coloured by the theme and linked.
(async () => {
  const byId = (id) => document.getElementById(id);
  const root = document.documentElement;
  const coarse = matchMedia("(pointer: coarse)").matches;

  // ---- payload -------------------------------------------------------------------------------

  function bytesOf(id) {
    const text = byId(id).textContent.trim();
    if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
    const plain = atob(text);
    const bytes = new Uint8Array(plain.length);
    for (let i = 0; i < plain.length; i++) bytes[i] = plain.charCodeAt(i);
    return bytes;
  }

  function inflated(id) {
    const stream = new Blob([bytesOf(id)]).stream();
    return new Response(stream.pipeThrough(new DecompressionStream("deflate")));
  }

  async function loadPlotly() {
    const script = document.createElement("script");
    script.textContent = await inflated("plotly").text();
    document.head.append(script);
    if (!window.Plotly) throw new Error("this browser did not run Plotly");
  }

  async function loadPayload() {
    const buffer = await inflated("payload").arrayBuffer();
    const length = new DataView(buffer).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
    let at = 4 + length;
    header.columns = header.columns.map(({ kind, length: n }) => {
      if (kind === "u") {
        const column = new Uint16Array(buffer.slice(at, at + 2 * n));
        at += 2 * n;
        return column;
      }
      const planes = new Uint8Array(buffer, at, 4 * n);
      const bytes = new Uint8Array(4 * n);
      for (let b = 0; b < 4; b++) for (let i = 0; i < n; i++) bytes[4 * i + b] = planes[b * n + i];
      at += 4 * n;
      return new Float32Array(bytes.buffer);
    });
    return header;
  }

  // ---- what the pixels can show ----------------------------------------------------------------

  /** First and last index (exclusive) of even samples in a window, and one beyond on either side. */
  function span(line, length, [from, to]) {
    const first = Math.floor((from - line.start) / line.step);
    const last = Math.ceil((to - line.start) / line.step) + 1;
    return [Math.max(0, first), Math.min(length, last)];
  }

  /** The least and the largest sample of every bucket, in their order: no peak is lost. */
  function wave(line, y, window, buckets) {
    const [first, last] = span(line, y.length, window);
    const size = Math.max(1, Math.ceil((last - first) / buckets));
    const x = [], out = [];
    const put = (i) => { x.push(line.start + i * line.step); out.push(y[i]); };
    if (size <= 2) {
      for (let i = first; i < last; i++) put(i);
      return [x, out];
    }
    for (let begin = Math.floor(first / size) * size; begin < last; begin += size) {
      let low = -1, high = -1;
      const end = Math.min(begin + size, y.length);
      for (let i = begin; i < end; i++) {
        if (Number.isNaN(y[i])) continue;
        if (low < 0 || y[i] < y[low]) low = i;
        if (high < 0 || y[i] > y[high]) high = i;
      }
      if (low < 0) { x.push(line.start + begin * line.step); out.push(null); continue; }
      put(Math.min(low, high));
      if (low !== high) put(Math.max(low, high));
    }
    return [x, out];
  }

  /** The corners of a line that mostly stands still; infinite values are gaps. */
  function corners(line, y, window) {
    const [first, last] = span(line, y.length, window);
    const x = [], out = [];
    for (let i = first; i < last; i++) {
      if (i > first && i < last - 1 && y[i] === y[i - 1] && y[i] === y[i + 1]) continue;
      x.push(line.start + i * line.step);
      out.push(Number.isFinite(y[i]) ? y[i] : null);
    }
    return [x, out];
  }

  /** Stretches of a window in which a bit occurs, at least a bucket long. */
  function stretches(band, mask, bit, window, buckets) {
    const [first, last] = span(band, mask.length, window);
    const size = Math.max(1, Math.ceil((last - first) / buckets));
    const found = [];
    for (let begin = Math.floor(first / size) * size; begin < last; begin += size) {
      const end = Math.min(begin + size, mask.length);
      let here = false;
      for (let i = begin; i < end && !here; i++) here = ((mask[i] >> bit) & 1) === 1;
      if (!here) continue;
      const before = found[found.length - 1];
      if (before && before[1] === begin) before[1] = end;
      else found.push([begin, end]);
    }
    return found.map((ends) => ends.map((i) => band.start + i * band.step));
  }

  // ---- theme -------------------------------------------------------------------------------------

  const probe = document.createElement("span");
  probe.hidden = true;
  document.body.append(probe);
  function colour(name) {
    probe.style.color = `var(--${name})`;
    return getComputedStyle(probe).color;
  }

  const dark = () => colour("dark") === "rgb(255, 255, 255)";
  const themeButton = byId("theme");
  function tellTheme() {
    themeButton.textContent = dark() ? "Light theme" : "Dark theme";
  }
  function setTheme(name) {
    if (name) root.dataset.theme = name;
    else delete root.dataset.theme;
    tellTheme();
  }
  function stored(value) {
    try {
      if (value === undefined) return localStorage.getItem("pulsempc-theme");
      localStorage.setItem("pulsempc-theme", value);
    } catch { /* a page without storage forgets */ }
    return null;
  }
  const kept = stored();
  setTheme(kept === "light" || kept === "dark" ? kept : null);
  themeButton.hidden = false;
  themeButton.addEventListener("click", () => {
    setTheme(dark() ? "light" : "dark");
    stored(root.dataset.theme);
    redraw();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    tellTheme();
    redraw();
  });

  // ---- figures -------------------------------------------------------------------------------------

  const LEFT = 54, RIGHT = 14;
  const PRINT_WIDTH = 680;
  const BAR = { good: 4, caution: 8, bad: 12 };
  const LEVELS = Object.keys(BAR);
  // Plotly reads some tags in text; none is meant here.
  const plain = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;");

  let report = null;
  let printing = false;
  const state = { window: null, whole: null, fit: true, hidden: new Map(), dirty: new Set() };

  function range(values, panel, zoomed) {
    let low = Infinity, high = -Infinity;
    const take = (y) => {
      for (const v of y) if (v !== null && Number.isFinite(v)) {
        if (v < low) low = v;
        if (v > high) high = v;
      }
    };
    values.filter(({ line }) => line.style.colour !== "bound").forEach(({ y }) => take(y));
    let outside = false;
    if (panel.limit !== null) take([panel.limit]);
    const room = (high - low) * (zoomed ? 0.75 : 2);
    for (const { line, y } of values) {
      if (line.style.colour !== "bound") continue;
      const near = y.filter((v) => v !== null && v >= low - room && v <= high + room);
      if (near.length < y.filter((v) => v !== null).length) outside = true;
      take(near);
    }
    if (low > high) [low, high] = panel.log ? [0.1, 1] : [-1, 1];
    if (panel.log) {
      low = Math.log10(low);
      high = Math.log10(high);
    }
    const edge = Math.max((high - low) * 0.06, panel.log ? 0.1 : 1e-9 + 1e-6 * Math.abs(high));
    return { range: [low - edge, high + edge], outside };
  }

  function build(figure, div) {
    const width = printing ? PRINT_WIDTH : div.clientWidth;
    const buckets = Math.max(100, width - LEFT - RIGHT);
    const window = figure.time ? state.window : null;
    const zoomed = figure.time
      && (state.window[0] > state.whole[0] || state.window[1] < state.whole[1]);
    const hidden = state.hidden.get(figure.id) ?? new Set();
    const ink = colour("ink"), quiet = colour("quiet"), grid = colour("grid");
    const { title: TITLE, gap: GAP, ticks: TICKS, bottom: BOTTOM } = report.layout;
    const above = (panel) => (panel.title ? TITLE : 0);
    const below = (k) => (figure.shared || k === figure.panels.length - 1 ? GAP : GAP + TICKS);
    const height = BOTTOM
      + figure.panels.reduce((sum, p, k) => sum + above(p) + p.height + below(k), 0);
    const inner = height - BOTTOM;
    const data = [];
    const layout = {
      width, height,
      margin: { l: LEFT, r: RIGHT, t: 0, b: BOTTOM, pad: 0 },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: ink },
      showlegend: false,
      hovermode: figure.time ? "x unified" : "closest",
      hoverlabel: { bgcolor: colour("page"), bordercolor: grid, font: { color: ink, size: 12 } },
      dragmode: coarse ? false : "zoom",
      annotations: [], shapes: [],
    };
    const abscissa = (last) => {
      const axis = {
        title: last ? { text: figure.x.title, standoff: 8 } : undefined,
        type: figure.x.log ? "log" : "linear",
        gridcolor: grid, zeroline: false, linecolor: quiet, ticks: "outside", tickcolor: quiet,
        ticklen: 4, hoverformat: figure.time ? ".3f" : ".4~g",
        nticks: Math.max(4, Math.floor(width / 90)),
        showspikes: figure.time, spikemode: "across", spikesnap: "cursor", spikethickness: 1,
        spikedash: "dot", spikecolor: quiet,
      };
      if (figure.time) axis.range = [...window];
      else if (figure.x.range) axis.range = figure.x.range.map(Math.log10);
      else if (figure.x.log) axis.dtick = 1;
      const ticks = Object.entries(figure.x.ticks);
      if (ticks.length) {
        const room = Math.floor((width - LEFT - RIGHT) / 52);
        const shown = ticks.length <= room ? ticks : ticks.filter((_, i) => i % 2 === 1);
        Object.assign(axis, {
          tickmode: "array", tickvals: shown.map(([, at]) => at), ticktext: shown.map(([t]) => t),
        });
      }
      return axis;
    };
    let top = height - BOTTOM;
    figure.panels.forEach((panel, k) => {
      const suffix = k ? String(k + 1) : "";
      const ceiling = top - above(panel);
      const floor = ceiling - panel.height;
      top = floor - below(k);
      const last = k === figure.panels.length - 1;
      const x = figure.shared ? "x" : `x${suffix}`;
      if (last || !figure.shared) {
        const name = figure.shared ? "xaxis" : `xaxis${suffix}`;
        layout[name] = { ...abscissa(last), anchor: `y${suffix}` };
      }
      const axis = {
        domain: [Math.max(0, floor / inner), ceiling / inner],
        anchor: x, gridcolor: grid, zeroline: false, fixedrange: figure.time,
        tickfont: { size: 11 }, automargin: false, hoverformat: ".4~g",
      };
      layout[`yaxis${suffix}`] = axis;
      let title = panel.title;
      if (panel.bands.length) {
        bands(panel, `y${suffix}`, axis, { data, layout, window, buckets, floor, inner });
      } else {
        const shown = [];
        for (const line of panel.lines) {
          if (hidden.has(line.name)) continue;
          const y = report.columns[line.y];
          let points;
          if (line.x !== null) points = [Array.from(report.columns[line.x]), Array.from(y)];
          else if (line.wave) points = wave(line, y, window, buckets);
          else points = corners(line, y, window);
          shown.push({ line, y: points[1] });
          data.push({
            type: "scatter", mode: "lines", x: points[0], y: points[1], xaxis: x,
            yaxis: `y${suffix}`, name: plain(line.name), connectgaps: false,
            line: {
              color: colour(line.style.colour), width: line.style.width, dash: line.style.dash, shape: line.shape,
              simplify: false,
            },
            hovertemplate: `%{y:.4~g} ${panel.unit}`
              + (figure.time ? "" : ` at %{x:.4~g} ${figure.x.unit}`),
          });
        }
        const fitted = range(shown, panel, zoomed);
        const id = `${figure.id} ${k}`;
        if (state.fit || !heldRanges.has(id)) heldRanges.set(id, fitted);
        const { range: limits, outside } = heldRanges.get(id);
        axis.range = [...limits];
        if (outside) title += " · bound out of view";
        if (panel.log) {
          axis.type = "log";
          axis.exponentformat = "power";
          const decades = limits[1] - limits[0];
          axis.dtick = decades > 1.3 ? Math.max(1, Math.ceil((decades * 26) / panel.height)) : "D2";
        } else {
          axis.nticks = Math.max(4, Math.floor(panel.height / 24));
        }
        if (panel.limit !== null) limitLine(panel, `y${suffix}`, layout);
      }
      if (title) {
        layout.annotations.push({
          xref: "paper", yref: "paper", x: 0, y: ceiling / inner, xanchor: "left",
          yanchor: "bottom", showarrow: false, text: plain(title),
          font: { size: 12.5, color: ink, weight: 600 },
        });
      }
    });
    return { data, layout, config: {
      displayModeBar: false, doubleClick: figure.time ? false : "reset", responsive: false,
      scrollZoom: false, showTips: false,
    } };
  }
  const heldRanges = new Map();

  function limitLine(panel, yref, layout) {
    layout.shapes.push({
      type: "line", xref: "paper", x0: 0, x1: 1, yref, y0: panel.limit, y1: panel.limit,
      line: { color: colour("bound"), width: 1.5, dash: "dot" },
    });
    layout.annotations.push({
      xref: "paper", x: 1, xanchor: "right", yref, y: panel.log ? Math.log10(panel.limit) : panel.limit,
      yanchor: "top", showarrow: false, font: { size: 11, color: colour("bound") },
      text: `deadline ${panel.limit.toLocaleString("en")} ${panel.unit}`,
    });
  }

  function bands(panel, yref, axis, { data, layout, window, buckets, floor, inner }) {
    const rows = panel.bands.length;
    Object.assign(axis, {
      range: [rows - 0.75, -0.75], showgrid: false, showticklabels: false, fixedrange: true,
    });
    panel.bands.forEach((band, row) => {
      const mask = report.columns[band.mask];
      layout.annotations.push({
        xref: "paper", x: 0, xanchor: "left", yref: "paper", yanchor: "bottom", showarrow: false,
        y: (floor + panel.height * (1 - (row + 0.75) / rows) + 5) / inner, text: plain(band.label),
        font: { size: 12, color: colour("ink") },
      });
      const ordered = [...band.states].sort(
        (a, b) => LEVELS.indexOf(a.level) - LEVELS.indexOf(b.level));
      for (const one of ordered) {
        const x = [], y = [];
        for (const [from, to] of stretches(band, mask, one.bit, window, buckets)) {
          x.push(Math.max(from, window[0]), Math.min(to, window[1]), null);
          y.push(row, row, null);
        }
        data.push({
          type: "scatter", mode: "lines", x, y, xaxis: "x", yaxis: yref, connectgaps: false,
          name: plain(band.label), line: { color: colour(one.colour), width: BAR[one.level] },
          hovertemplate: plain(one.name),
        });
      }
    });
  }

  function draw(id) {
    const figure = report.figures[id];
    const div = byId(`plot-${id}`);
    const { data, layout, config } = build(figure, div);
    state.dirty.delete(id);
    const first = !div.classList.contains("js-plotly-plot");
    const done = Plotly.react(div, data, layout, config);
    if (first && figure.time) {
      div.on("plotly_relayout", (change) => {
        const range = change["xaxis.range"] ?? [change["xaxis.range[0]"], change["xaxis.range[1]"]];
        if (Number.isFinite(range[0]) && Number.isFinite(range[1])) setWindow(range[0], range[1]);
      });
      div.on("plotly_doubleclick", () => setWindow(...state.whole));
    }
    return done;
  }

  // ---- which are drawn when ------------------------------------------------------------------------

  const seen = new Set();
  const watcher = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      const id = entry.target.dataset.figure;
      if (entry.isIntersecting) seen.add(id);
      else seen.delete(id);
    }
    drawSeen();
  }, { rootMargin: "200px" });

  function drawSeen() {
    if (report) for (const id of seen) if (state.dirty.has(id)) draw(id);
  }
  const idle = window.requestIdleCallback ?? ((call) => setTimeout(call, 50));
  function drawRest() {
    const [next] = state.dirty;
    if (next === undefined) return;
    draw(next);
    idle(drawRest);
  }
  function redraw(ids = Object.keys(report?.figures ?? {})) {
    ids.forEach((id) => state.dirty.add(id));
    drawSeen();
    idle(drawRest);
  }

  // ---- the window in time, common to all ------------------------------------------------------------

  const bar = byId("timebar");
  const [fromBox, toBox, told] = ["time-from", "time-to", "time-told"].map(byId);
  function setWindow(from, to) {
    const [begin, end] = state.whole;
    const least = Math.min(report.finest * 4, end - begin);
    if (!(to - from >= least)) {
      const middle = (from + to) / 2;
      [from, to] = [middle - least / 2, middle + least / 2];
    }
    const width = Math.min(to - from, end - begin);
    from = Math.min(Math.max(from, begin), end - width);
    state.window = [from, from + width];
    fromBox.value = String(+from.toFixed(4));
    toBox.value = String(+(from + width).toFixed(4));
    told.textContent = `Showing ${from.toFixed(3)} to ${(from + width).toFixed(3)} s`;
    redraw(Object.values(report.figures).filter((f) => f.time).map((f) => f.id));
  }
  function move(how) {
    const [from, to] = state.window;
    const width = to - from, middle = (from + to) / 2;
    const moves = {
      all: state.whole,
      in: [middle - width / 4, middle + width / 4],
      out: [middle - width, middle + width],
      earlier: [from - width / 2, to - width / 2],
      later: [from + width / 2, to + width / 2],
    };
    setWindow(...moves[how]);
  }
  function listen() {
    bar.querySelectorAll("[data-move]").forEach((button) => {
      button.addEventListener("click", () => move(button.dataset.move));
    });
    for (const box of [fromBox, toBox]) {
      box.addEventListener("change", () => {
        const [from, to] = [fromBox.valueAsNumber, toBox.valueAsNumber];
        if (Number.isFinite(from) && Number.isFinite(to) && to > from) setWindow(from, to);
        else setWindow(...state.window);
      });
    }
    byId("time-fit").addEventListener("change", (event) => {
      state.fit = event.target.checked;
      redraw();
    });
    document.querySelectorAll("[data-from]").forEach((button) => {
      button.hidden = false;
      button.addEventListener("click", () => {
        setWindow(Number(button.dataset.from), Number(button.dataset.to));
        byId(`title-${button.dataset.at}`).scrollIntoView({ block: "start" });
      });
    });
    bar.hidden = false;
  }

  // ---- legends -----------------------------------------------------------------------------------------

  const SVG = "http://www.w3.org/2000/svg";
  const STROKES = {
    solid: "", dash: "7 4", dot: "2 3", dashdot: "7 3 2 3", longdash: "12 4",
    longdashdot: "12 3 2 3",
  };
  function swatch(name, dash, width) {
    const svg = document.createElementNS(SVG, "svg");
    svg.setAttribute("viewBox", "0 0 30 12");
    svg.setAttribute("aria-hidden", "true");
    const line = document.createElementNS(SVG, "line");
    const set = { x1: 0, x2: 30, y1: 6, y2: 6, "stroke-width": width, "stroke-dasharray": dash };
    for (const [key, value] of Object.entries(set)) line.setAttribute(key, value);
    line.style.stroke = `var(--${name})`;
    svg.append(line);
    return svg;
  }
  function legend(figure) {
    const place = byId(`legend-${figure.id}`);
    const lines = new Map();
    for (const panel of figure.panels) for (const line of panel.lines) {
      if (!lines.has(line.name)) lines.set(line.name, line);
    }
    for (const line of lines.values()) {
      const button = document.createElement("button");
      button.type = "button";
      button.setAttribute("aria-pressed", "true");
      button.append(swatch(line.style.colour, STROKES[line.style.dash], 2.5), line.name);
      button.addEventListener("click", () => {
        const hidden = state.hidden.get(figure.id) ?? new Set();
        state.hidden.set(figure.id, hidden);
        const show = hidden.delete(line.name);
        if (!show) hidden.add(line.name);
        button.setAttribute("aria-pressed", String(show));
        redraw([figure.id]);
      });
      place.append(button);
    }
    const states = new Map();
    for (const panel of figure.panels) for (const band of panel.bands) for (const one of band.states) {
      // what is as it should be needs no name of its own
      const name = one.level === "good" ? "as it should be" : one.name;
      states.set(`${name} ${one.colour}`, { ...one, name });
    }
    const worse = (a, b) => LEVELS.indexOf(a.level) - LEVELS.indexOf(b.level);
    for (const one of [...states.values()].sort(worse)) {
      const item = document.createElement("span");
      item.append(swatch(one.colour, "", BAR[one.level]), one.name);
      place.append(item);
    }
  }

  // ---- paper -----------------------------------------------------------------------------------------------

  let theme = null;
  function paper(on) {
    if (!report || on === printing) return;
    printing = on;
    if (on) {
      theme = root.dataset.theme ?? "";
      root.dataset.theme = "light";
      document.querySelectorAll("details.numbers").forEach((d) => { d.open = true; });
    } else if (theme) root.dataset.theme = theme;
    else delete root.dataset.theme;
    Object.keys(report.figures).forEach(draw);
  }
  window.addEventListener("beforeprint", () => paper(true));
  window.addEventListener("afterprint", () => paper(false));
  matchMedia("print").addEventListener("change", (event) => paper(event.matches));

  // ---- start ---------------------------------------------------------------------------------------------------

  try {
    const [loaded] = await Promise.all([loadPayload(), loadPlotly()]);
    report = loaded;
    const figures = Object.values(report.figures);
    figures.forEach(legend);
    state.whole = report.span;
    state.window = [...report.span];
    figures.forEach((figure) => {
      state.dirty.add(figure.id);
      watcher.observe(byId(`plot-${figure.id}`));
      byId(`save-${figure.id}`).hidden = false;
      byId(`save-${figure.id}`).addEventListener("click", () => {
        Plotly.downloadImage(byId(`plot-${figure.id}`), { format: "svg", filename: figure.id });
      });
    });
    if (figures.some((figure) => figure.time)) {
      listen();
      setWindow(...report.span);
    }
    let width = root.clientWidth;
    new ResizeObserver(() => {
      if (root.clientWidth === width || printing) return;
      width = root.clientWidth;
      redraw();
    }).observe(root);
    requestAnimationFrame(() => {
      drawSeen();
      root.dataset.ready = String(Math.round(performance.now()));
      idle(drawRest);
    });
  } catch (problem) {
    const place = byId("problem");
    place.textContent = `The figures cannot be drawn: ${problem.message}. `
      + "The tables and the sentences under each figure hold what they show.";
    place.hidden = false;
  }
})();
