"use strict";

// The plots: the last minute of every figure, drawn by plotly a few times a second.
const plots = (() => {
  const SPAN_S = 60;
  const MOST_POINTS = 1500;
  // Values further apart than this are not joined, s.
  const PAUSE_S = 1.5;
  // Of so few points each is drawn.
  const FEW = 120;
  let rows = [];

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const faint = (hex) => hex + "33";
  const or = (value) => (value === undefined ? null : value);

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

  function line(of, name, dash, wraps) {
    const { x, y } = series(of, wraps);
    // Single points between breaks would not be seen in a line.
    const lone = (k) => (k === 0 || y[k - 1] === null) && (k + 1 === y.length || y[k + 1] === null);
    const size = y.map((_, k) => (y.length <= FEW || lone(k) ? 4 : 0));
    return { x, y, type: "scatter", mode: "lines+markers", marker: { size }, line: { color: colour(name), width: 2, dash }, hovertemplate: "%{y:.4g}<extra></extra>" };
  }

  function band(of, sigma, name, wraps) {
    const { x, y, rows: of_rows } = series(of, wraps);
    // A band for each unbroken stretch, since a filled one must not lead across a gap.
    const bands = [];
    for (let from = 0; from < y.length; from++) {
      if (y[from] === null) continue;
      let to = from;
      while (to < y.length && y[to] !== null) to++;
      const edge = (sign) => ({
        x: x.slice(from, to), y: y.slice(from, to).map((value, k) => value + sign * 2 * sigma(of_rows[from + k])),
        type: "scatter", mode: "lines", line: { width: 0 }, hoverinfo: "skip",
      });
      bands.push(edge(-1), { ...edge(1), fill: "tonexty", fillcolor: faint(colour(name)) });
      from = to;
    }
    return bands;
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
      ...band((r) => r.theta_deg, (r) => r.sigma_theta_deg, "--c1"),
      line((r) => r.theta_deg, "--c1"), line((r) => r.expected_theta_deg, "--model", "dot"),
    ],
    delta: () => [
      // Near straight the azimuth is anything: a band wider than the plot says nothing.
      ...band((r) => r.delta_deg, (r) => Math.min(r.sigma_delta_deg, 90), "--c1", true),
      line((r) => r.delta_deg, "--c1", undefined, true), line((r) => r.expected_delta_deg, "--model", "dot", true),
    ],
    eta: () => [
      ...band((r) => r.estimate && r.estimate.eta, (r) => r.estimate.sd_eta, "--c1"),
      line((r) => r.estimate && r.estimate.eta, "--c1"),
    ],
    lambda: () => [
      ...band((r) => r.estimate && r.estimate.lambda_mm, (r) => r.estimate.sd_lambda_mm, "--c1"),
      line((r) => r.estimate && r.estimate.lambda_mm, "--c1"),
    ],
    phi: () => [
      ...band((r) => r.stem && r.stem.phi_deg, (r) => r.stem.sd_phi_deg, "--c1"),
      line((r) => r.stem && r.stem.phi_deg, "--c1"),
    ],
    residual: () => backbones().map((k) => line((r) => r.residual_mm && 1000 * r.residual_mm[k], "--" + of_backbone(k))),
    latency: () => [line((r) => r.latency_ms, "--c1")],
  };

  // How far apart the ticks of an angle's axis are, degrees: as angles are told, six of them at most; plotly's own choice within some 30°.
  function angle_step(traces) {
    const values = traces.flatMap((trace) => trace.y).filter((value) => value !== null);
    const apart = (Math.max(...values) - Math.min(...values)) / 6;
    return apart > 5 ? [15, 30, 45, 60, 90].find((step) => step >= apart) || 180 : undefined;
  }

  function draw() {
    if (!rows.length || document.hidden) return;
    const axis = { gridcolor: colour("--line"), zeroline: false, color: colour("--soft"), linecolor: colour("--line") };
    const oldest = rows[0].time_s - rows[rows.length - 1].time_s;
    for (const [name, traces] of Object.entries(shown)) {
      if (document.getElementById("plot-" + name).closest("[hidden]")) continue;
      const drawn = traces();
      const dtick = name === "theta" || name === "delta" ? angle_step(drawn) : undefined;
      const layout = {
        margin: { l: 52, r: 8, t: 6, b: 30 }, showlegend: false, paper_bgcolor: "transparent", plot_bgcolor: "transparent",
        font: { color: colour("--soft"), size: 11 },
        xaxis: { ...axis, range: [Math.max(-SPAN_S, Math.min(oldest, -5)), 0], ticksuffix: " s" },
        yaxis: { ...axis, rangemode: name === "latency" ? "tozero" : "normal", dtick },
      };
      Plotly.react("plot-" + name, drawn, layout, { displayModeBar: false, responsive: true, staticPlot: false });
    }
  }

  return { add, draw };
})();
