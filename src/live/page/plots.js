"use strict";

// The plots: the last minute of every figure, drawn by plotly a few times a second.
const plots = (() => {
  const SPAN_S = 60;
  const MOST_POINTS = 1500;
  let rows = [];

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const faint = (hex) => hex + "33";

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

  // A gap in the line where there is no value; azimuths also break where they wrap around.
  function column(of, wraps) {
    let last = null;
    return rows.map((row) => {
      const value = of(row);
      const broken = wraps && last !== null && value !== null && Math.abs(value - last) > 180;
      last = value;
      return value === null || value === undefined || broken ? null : value;
    });
  }

  function line(y, name, dash) {
    return { x: times(), y, type: "scatter", mode: "lines", line: { color: colour(name), width: 2, dash }, hovertemplate: "%{y:.4g}<extra></extra>" };
  }

  function band(of, sigma, name, wraps) {
    const edge = (sign) => ({
      x: times(), y: column((row) => (of(row) === null ? null : of(row) + sign * 2 * sigma(row)), wraps),
      type: "scatter", mode: "lines", line: { width: 0 }, hoverinfo: "skip",
    });
    // A band for each unbroken stretch, since a filled one must not lead across a gap.
    const [low, high] = [edge(-1), edge(1)];
    const bands = [];
    for (let from = 0; from < low.y.length; from++) {
      if (low.y[from] === null) continue;
      let to = from;
      while (to < low.y.length && low.y[to] !== null && high.y[to] !== null) to++;
      const part = (edge) => ({ ...edge, x: edge.x.slice(from, to), y: edge.y.slice(from, to) });
      bands.push(part(low), { ...part(high), fill: "tonexty", fillcolor: faint(colour(name)) });
      from = to;
    }
    return bands;
  }

  // Seconds before now.
  function times() {
    const now = rows.length ? rows[rows.length - 1].time_s : 0;
    return rows.map((row) => row.time_s - now);
  }

  // Their indices, named in their colours beside the plot.
  function backbones() {
    const row = rows.find((r) => r.residual_mm);
    const indices = row ? row.residual_mm.map((_, k) => k) : [];
    document.getElementById("backbones").innerHTML = indices.map((k) => `<b class="c${k + 1}">${k + 1}</b>`).join(", ");
    return indices;
  }

  const or = (value) => (value === undefined ? null : value);
  const shown = {
    theta: () => [
      ...band((r) => or(r.theta_deg), (r) => r.sigma_theta_deg, "--c1"),
      line(column((r) => r.theta_deg), "--c1"), line(column((r) => r.expected_theta_deg), "--c2", "dot"),
    ],
    delta: () => [
      // Near straight the azimuth is anything: a band wider than the plot says nothing.
      ...band((r) => or(r.delta_deg), (r) => Math.min(r.sigma_delta_deg, 90), "--c1", true),
      line(column((r) => r.delta_deg, true), "--c1"), line(column((r) => r.expected_delta_deg, true), "--c2", "dot"),
    ],
    eta: () => [
      ...band((r) => (r.estimate ? r.estimate.eta : null), (r) => r.estimate.sd_eta, "--c1"),
      line(column((r) => r.estimate && r.estimate.eta), "--c1"),
    ],
    lambda: () => [
      ...band((r) => (r.estimate ? r.estimate.lambda_mm : null), (r) => r.estimate.sd_lambda_mm, "--c1"),
      line(column((r) => r.estimate && r.estimate.lambda_mm), "--c1"),
    ],
    phi: () => [
      ...band((r) => (r.stem ? r.stem.phi_deg : null), (r) => r.stem.sd_phi_deg, "--c1"),
      line(column((r) => r.stem && r.stem.phi_deg), "--c1"),
    ],
    residual: () => backbones().map((k) => line(column((r) => r.residual_mm && 1000 * r.residual_mm[k]), "--c" + (k + 1))),
    latency: () => [line(column((r) => r.latency_ms), "--c1")],
  };

  function draw() {
    if (!rows.length || document.hidden) return;
    const axis = { gridcolor: colour("--line"), zeroline: false, color: colour("--soft"), linecolor: colour("--line") };
    const oldest = times()[0];
    for (const [name, traces] of Object.entries(shown)) {
      if (document.getElementById("plot-" + name).closest("[hidden]")) continue;
      const layout = {
        margin: { l: 52, r: 8, t: 6, b: 30 }, showlegend: false, paper_bgcolor: "transparent", plot_bgcolor: "transparent",
        font: { color: colour("--soft"), size: 11 },
        xaxis: { ...axis, range: [Math.max(-SPAN_S, Math.min(oldest, -5)), 0], ticksuffix: " s" },
        yaxis: { ...axis, rangemode: name === "latency" ? "tozero" : "normal" },
      };
      Plotly.react("plot-" + name, traces(), layout, { displayModeBar: false, responsive: true, staticPlot: false });
    }
  }

  return { add, draw };
})();
