"use strict";

// The plots: the last minute of every figure, drawn as SVG a few times a second.
const plots = (() => {
  const SPAN_S = 60;
  const MOST_POINTS = 1500;
  // Values further apart than this are not joined, s.
  const PAUSE_S = 1.5;
  // If there are at most so many points, each is drawn.
  const FEW = 120;
  // Space for the labels of the axes, px.
  const MARGIN = { left: 52, right: 8, top: 8, bottom: 24 };
  // Distance between two labels of an axis, at least, px.
  const APART = { x: 90, y: 36 };
  let rows = [];
  // Where the pointer is in each plot, px from its left side.
  const pointer = {};

  const or = (value) => (value === undefined ? null : value);
  const written = (value, decimals) => (Math.abs(value) < 0.5 * 10 ** -decimals ? 0 : value).toFixed(decimals).replace("-", "−");

  // Keeps the latest minute, and starts anew where time goes back.
  function add(fresh) {
    for (const row of fresh) {
      if (rows.length && row.time_s < rows[rows.length - 1].time_s) rows = [];
      rows.push(row);
    }
    if (!rows.length) return;
    const from = rows[rows.length - 1].time_s - SPAN_S;
    let first = rows.findIndex((row) => row.time_s >= from);
    // Thinned where there are more than can be seen.
    rows = rows.slice(first);
    while (rows.length > 2 * MOST_POINTS) rows = rows.filter((_, k) => k % 2);
  }

  // The values with their times. The line breaks (null) where there is no value or none for a while, and where an azimuth wraps around.
  function series(of, wraps) {
    const now = rows.length ? rows[rows.length - 1].time_s : 0;
    const points = { x: [], y: [], rows: [] };
    const push = (x, y, row) => { points.x.push(x); points.y.push(y); points.rows.push(row); };
    let last = null;
    for (const row of rows) {
      const value = or(of(row));
      const breaks = last && (value === null || row.time_s - last.time_s > PAUSE_S || (wraps && Math.abs(value - last.value) > 180));
      if (breaks) push(row.time_s - now, null, null);
      if (value !== null) push(row.time_s - now, value, row);
      last = value === null ? null : { time_s: row.time_s, value };
    }
    return points;
  }

  function line(of, colour, dash, wraps) {
    const { x, y } = series(of, wraps);
    return { x, y, colour, dash };
  }

  // A band of two standard deviations to either side of the values.
  function band(of, sigma, colour, wraps) {
    const { x, y, rows: of_rows } = series(of, wraps);
    const half = (k) => (y[k] === null ? NaN : 2 * sigma(of_rows[k]));
    const edge = (sign) => y.map((value, k) => (Number.isFinite(half(k)) ? value + sign * half(k) : null));
    return { x, low: edge(-1), high: edge(1), colour };
  }

  // A backbone's colour is the one that it has in reports, and none of those for measured and expected; the eighth has the first again.
  const of_backbone = (k) => `c${((k + 1) % 8) + 1}`;

  // Their indices, named in their colours beside the plot.
  function backbones() {
    const row = rows.find((r) => r.residual_mm);
    const indices = row ? row.residual_mm.map((_, k) => k) : [];
    document.getElementById("backbones").innerHTML = indices.map((k) => `<b class="${of_backbone(k)}">${k + 1}</b>`).join(", ");
    return indices;
  }

  const shown = {
    theta: () => [
      band((r) => r.theta_deg, (r) => r.sigma_theta_deg, "--c1"),
      line((r) => r.theta_deg, "--c1"), line((r) => r.expected_theta_deg, "--model", "dot"),
    ],
    delta: () => [
      // Near straight the azimuth is anything: a band wider than the plot says nothing.
      band((r) => r.delta_deg, (r) => Math.min(r.sigma_delta_deg, 90), "--c1", true),
      line((r) => r.delta_deg, "--c1", undefined, true), line((r) => r.expected_delta_deg, "--model", "dot", true),
    ],
    eta: () => [
      band((r) => r.estimate && r.estimate.eta, (r) => r.estimate.sd_eta, "--c1"),
      line((r) => r.estimate && r.estimate.eta, "--c1"),
    ],
    lambda: () => [
      band((r) => r.estimate && r.estimate.lambda_mm, (r) => r.estimate.sd_lambda_mm, "--c1"),
      line((r) => r.estimate && r.estimate.lambda_mm, "--c1"),
    ],
    phi: () => [
      band((r) => r.stem && r.stem.phi_deg, (r) => r.stem.sd_phi_deg, "--c1"),
      line((r) => r.stem && r.stem.phi_deg, "--c1"),
    ],
    residual: () => backbones().map((k) => line((r) => r.residual_mm && 1000 * r.residual_mm[k], "--" + of_backbone(k))),
    latency: () => [line((r) => r.latency_ms, "--c1")],
  };

  // How far apart an axis is labelled: 1, 2 or 5 times a power of ten; an angle beyond 30° as angles are told.
  function step_of(span, labels, is_angle) {
    const apart = span / Math.max(labels, 1);
    if (is_angle && apart > 5) return [15, 30, 45, 60, 90].find((step) => step >= apart) || 180;
    const power = 10 ** Math.floor(Math.log10(apart));
    return power * ([1, 2, 5].find((factor) => factor * power >= apart) || 10);
  }

  function ticks([from, to], step) {
    const first = Math.ceil(from / step - 1e-9);
    return Array.from({ length: Math.max(0, Math.floor(to / step + 1e-9) - first + 1) }, (_, k) => (first + k) * step);
  }

  // The values between which a plot goes, with a little room; from zero on where nothing can be below.
  function range_of(traces, from_zero) {
    const values = traces.flatMap((trace) => trace.y || [...trace.low, ...trace.high]).filter((value) => value !== null);
    if (!values.length) return [0, 1];
    const low = from_zero ? 0 : Math.min(...values);
    const high = Math.max(...values);
    const room = 0.06 * (high - low) || 0.02 * Math.abs(high) || 1;
    return [from_zero ? 0 : low - room, high + room];
  }

  // The stretches of a series that are not interrupted, as [from, to).
  function stretches(values) {
    const found = [];
    for (let from = 0; from < values.length; from++) {
      if (values[from] === null) continue;
      let to = from;
      while (to < values.length && values[to] !== null) to++;
      found.push([from, to]);
      from = to;
    }
    return found;
  }

  function path_of_line({ x, y, colour, dash }, place) {
    const at = (k) => `${place.x(x[k]).toFixed(1)} ${place.y(y[k]).toFixed(1)}`;
    const parts = stretches(y);
    const indices = ([from, to]) => Array.from({ length: to - from }, (_, k) => from + k);
    const path = parts.map((part) => "M" + indices(part).map(at).join("L")).join("");
    // Single points between breaks would not be seen in a line.
    const dots = parts.filter(([from, to]) => y.length <= FEW || to - from === 1).flatMap(indices).map((k) => `M${at(k)}h0`).join("");
    const style = `stroke="var(${colour})"`;
    return `<path class="line" ${style} ${dash ? 'stroke-dasharray="2 4"' : ""} d="${path}"/><path class="dots" ${style} d="${dots}"/>`;
  }

  function path_of_band({ x, low, high, colour }, place) {
    const at = (values) => (k) => `${place.x(x[k]).toFixed(1)} ${place.y(values[k]).toFixed(1)}`;
    const outline = ([from, to]) => {
      const indices = Array.from({ length: to - from }, (_, k) => from + k);
      return "M" + indices.map(at(high)).concat(indices.reverse().map(at(low))).join("L") + "Z";
    };
    return `<path class="band" fill="var(${colour})" d="${stretches(low).map(outline).join("")}"/>`;
  }

  // The values nearest to the pointer, with a line through them.
  function under_pointer(traces, place, px, decimals) {
    const near = (trace) => {
      const known = trace.x.map((_, k) => k).filter((k) => trace.y[k] !== null);
      return known.reduce((best, k) => (best === null || Math.abs(place.x(trace.x[k]) - px) < Math.abs(place.x(trace.x[best]) - px) ? k : best), null);
    };
    const found = traces.filter((trace) => trace.y).map((trace) => ({ trace, k: near(trace) })).filter(({ k }) => k !== null);
    if (!found.length) return "";
    const at = found[0].trace.x[found[0].k];
    const values = found.map(({ trace, k }) => `<tspan fill="var(${trace.colour})" dx="8">${written(trace.y[k], decimals)}</tspan>`).join("");
    const { left, top } = MARGIN;
    return `<path class="pointer" d="M${place.x(at).toFixed(1)} ${top}V${place.bottom}"/><text class="told" x="${left + 4}" y="${top + 10}">${written(at, 1)} s${values}</text>`;
  }

  function draw_one(name) {
    const div = document.getElementById("plot-" + name);
    if (!rows.length || document.hidden || div.closest("[hidden]")) return;
    const traces = shown[name]();
    const [width, height] = [div.clientWidth, div.clientHeight];
    const inner = { x: width - MARGIN.left - MARGIN.right, y: height - MARGIN.top - MARGIN.bottom };
    if (inner.x <= 0 || inner.y <= 0) return;
    const oldest = rows[0].time_s - rows[rows.length - 1].time_s;
    const xs = [Math.max(-SPAN_S, Math.min(oldest, -5)), 0];
    const ys = range_of(traces, name === "latency");
    const place = {
      x: (value) => MARGIN.left + (inner.x * (value - xs[0])) / (xs[1] - xs[0]),
      y: (value) => MARGIN.top + (inner.y * (ys[1] - value)) / (ys[1] - ys[0]),
      bottom: height - MARGIN.bottom,
    };
    const steps = [step_of(xs[1] - xs[0], inner.x / APART.x, false), step_of(ys[1] - ys[0], inner.y / APART.y, name === "theta" || name === "delta")];
    const decimals = Math.max(0, -Math.floor(Math.log10(steps[1]) + 1e-9));
    const across = ticks(ys, steps[1]).map((y) => `<path class="grid" d="M${MARGIN.left} ${place.y(y).toFixed(1)}H${width - MARGIN.right}"/>` +
      `<text x="${MARGIN.left - 6}" y="${(place.y(y) + 4).toFixed(1)}" text-anchor="end">${written(y, decimals)}</text>`);
    const along = ticks(xs, steps[0]).map((x) => `<path class="grid" d="M${place.x(x).toFixed(1)} ${MARGIN.top}V${place.bottom}"/>` +
      `<text x="${place.x(x).toFixed(1)}" y="${height - 6}" text-anchor="${x === 0 ? "end" : "middle"}">${written(x, 0)} s</text>`);
    const drawn = traces.map((trace) => (trace.y ? path_of_line(trace, place) : path_of_band(trace, place)));
    const told = pointer[name] === undefined ? "" : under_pointer(traces, place, pointer[name], decimals + 1);
    const label = div.parentElement.querySelector("figcaption").textContent;
    div.innerHTML = `<svg role="img" aria-label="${label}" viewBox="0 0 ${width} ${height}">${across.join("")}${along.join("")}${drawn.join("")}${told}</svg>`;
  }

  for (const name of Object.keys(shown)) {
    const div = document.getElementById("plot-" + name);
    div.addEventListener("pointermove", (event) => { pointer[name] = event.clientX - div.getBoundingClientRect().left; draw_one(name); });
    div.addEventListener("pointerleave", () => { delete pointer[name]; draw_one(name); });
  }

  const draw = () => Object.keys(shown).forEach(draw_one);

  return { add, draw };
})();
