"use strict";

const by = (id) => document.getElementById(id);
const put = (id, text) => { if (by(id).textContent !== text) by(id).textContent = text; };
const minus = (text) => text.replace("-", "−");
const fixed = (value, places) => minus(value.toFixed(places));
let state = null;

function chip(id, kind, text) {
  by(id).className = "chip " + kind;
  put(id, text);
}

// What a value is given with: as many places as its standard deviation deserves.
function withSigma(value, sigma, unit) {
  if (!(sigma < 1e3)) return fixed(value, 3) + unit;
  const places = Math.min(4, Math.max(0, 1 - Math.floor(Math.log10(sigma || 1e-4))));
  return `${fixed(value, places)} ± ${sigma.toFixed(places)}${unit}`;
}

function showSource(s) {
  put("source-name", s.source_name);
  const words = { waiting: ["warn", "camera: waiting"], running: ["good", "camera: running"], lost: ["bad", "camera: lost"], ended: ["warn", "recording: ended"] };
  const [kind, text] = s.paused ? ["warn", "paused"] : words[s.source.state];
  chip("chip-source", kind, text);
  by("trouble").hidden = !s.source.trouble;
  put("trouble", s.source.trouble || "");
  put("rate", fixed(s.source.rate_fps, 1));
  const back = s.source.reconnects ? `, came back ${s.source.reconnects}×` : "";
  const size = s.source.settings && s.source.settings.size ? `, ${s.source.settings.size.join("×")}` : "";
  put("rate-more", `${s.source.dropped} of ${s.source.frames} dropped${back}${size}`);
  put("latency", `${fixed(s.latency.p50_ms, 1)} ms`);
  put("latency-more", `99 % below ${fixed(s.latency.p99_ms, 1)} ms`);
  put("pause", s.paused ? "Continue" : "Pause");
  by("pause").setAttribute("aria-pressed", String(s.paused));
}

function showPace(pace) {
  const words = { fresh: ["", ""], behind: ["warn", "behind"], late: ["bad", "frames late"] };
  by("chip-pace").hidden = by("pace").hidden = pace.state === "fresh";
  chip("chip-pace", ...words[pace.state]);
  by("pace").className = "trouble " + words[pace.state][0];
  put("pace", pace.sentence || "");
}

function showEncoders(e) {
  const kinds = { none: ["", "no encoders"], log: ["good", "encoders: log"], waiting: ["warn", "encoders: waiting"], running: ["good", "encoders: running"], lost: ["bad", "encoders: lost"] };
  chip("chip-encoders", ...kinds[e.state]);
  const clocks = { unknown: "", shared: "one clock with the camera", foreign: "own clock", given: "clock offset given" };
  put("encoders", e.state === "none" ? "none" : e.readings.toLocaleString("en"));
  const parts = [e.trouble, clocks[e.clock]];
  if (e.clock === "foreign" || e.clock === "given") parts.push(`offset ${fixed(e.offset_s, 3)} s`);
  if (e.lag) parts.push(`by the motion the picture is ${Math.abs(1000 * e.lag.seconds).toFixed(0)} ms ${e.lag.seconds < 0 ? "ahead" : "late"}`);
  if (e.bad_lines) parts.push(`${e.bad_lines} bad lines`);
  put("encoders-more", e.state === "none" ? "" : parts.filter(Boolean).join(", "));
}

function showMeasured(s) {
  const row = s.latest;
  put("measured", s.measured.toLocaleString("en"));
  const resumed = s.resumed ? `, ${s.resumed.toLocaleString("en")} from before` : "";
  put("measured-more", `of ${s.measurements.toLocaleString("en")}, ${s.rejected} rejected${resumed}`);
  for (const [name, value, sigma, expected] of [
    ["theta", row && row.theta_deg, row && row.sigma_theta_deg, row && row.expected_theta_deg],
    ["delta", row && row.delta_deg, row && row.sigma_delta_deg, row && row.expected_delta_deg],
  ]) {
    const known = typeof value === "number";
    put(name, !known ? "–" : name === "delta" && sigma > 90 ? "unknown" : withSigma(value, sigma, "°"));
    const model = typeof expected === "number" ? `the model expects ${fixed(expected, 2)}°` : "";
    put(name + "-more", row && !known ? `frame ${row.index}: ${row.status.replaceAll("_", " ")}` : model || "\u00a0");
  }
  const e = s.estimate;
  for (const id of ["stem-box", "stem-figure"]) by(id).hidden = !s.stem;
  if (s.stem) put("phi", withSigma(s.stem.phi_deg, s.stem.sd_phi_deg, "°"));
  put("eta", e ? fixed(e.eta, 4) : "–");
  put("eta-more", e ? `± ${e.sd_eta.toFixed(4)}, ${e.samples.toLocaleString("en")} rows` : "not known yet");
  put("lambda", e ? `${fixed(e.lambda_mm, 4)} mm` : "–");
  put("lambda-more", e ? `± ${e.sd_lambda_mm.toFixed(4)} mm` : "not known yet");
}

// As the report of `run` says it.
function showVerdict(verdict) {
  const words = {
    good: ["good", "Good: nothing speaks against this result."],
    look: ["warn", "Look at this before you use the result."],
    do_not_use: ["bad", "Do not use this result."],
  };
  const [kind, says] = words[verdict.level];
  by("verdict-box").className = "gap " + kind;
  put("verdict", says);
  by("reasons").hidden = !verdict.reasons.length;
  const told = JSON.stringify(verdict.reasons);
  if (by("reasons").dataset.told === told) return;
  by("reasons").dataset.told = told;
  by("reasons").replaceChildren(...verdict.reasons.map(({ text, remedy }) => {
    const item = Object.assign(document.createElement("li"), { textContent: text.replaceAll("`", "") });
    item.append(Object.assign(document.createElement("span"), { textContent: "What to do: " + remedy.replaceAll("`", "") }));
    return item;
  }));
}

function showGap(s) {
  const gap = s.gap;
  const figures = `mean square bending ${gap.bending.toFixed(1)}, common ${gap.common.toFixed(1)}; 1 is noise`;
  const words = {
    unknown: ["", "gap: not known yet", "Too few measurements to compare with the model yet."],
    noise: ["good", "gap: noise", `The model accounts for what is measured (${figures}).`],
    above: ["bad", "gap: above noise", `The robot does something that the model does not know (${figures}${gap.rejected > 0.05 ? `; ${Math.round(100 * gap.rejected)} % rejected` : ""}).`],
  };
  const [kind, short, long] = words[gap.state];
  chip("chip-gap", kind, short);
  by("gap-box").className = "gap " + kind;
  put("gap-text", long);
  const d = s.discovery;
  const file = d && d.verdict === "named" ? " discovered.toml has the model with it." : "";
  put("discovery", d ? d.sentence + file + (d.running ? " (looking again …)" : "") : "");
  put("structures", d && d.followed ? "By what was measured since: " + d.followed + "." : "");
  put("notice-count", String(s.notices.length));
  const list = by("notices");
  if (list.childElementCount !== s.notices.length || (list.lastChild && list.lastChild.textContent !== s.notices.at(-1))) {
    list.replaceChildren(...s.notices.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
  }
}

function showTable(publication) {
  const words = {
    nothing: ["", "", ""],
    current: ["good", "table: current", ""],
    stale: ["bad", "table: stale", "The table in the folder is the last one published, and is not written anew: "],
    withheld: ["bad", "no table", "No table is written: "],
  };
  const [kind, short, long] = words[publication.state];
  by("chip-table").hidden = publication.state === "nothing";
  chip("chip-table", kind, short);
  put("publication", long && long + publication.reason + ".");
}

function showEnd(ended) {
  for (const id of ["pause", "reference", "reset", "save"]) {
    by(id).disabled = ended;
    by(id).title = ended ? "The run is over." : "";
  }
}

function show(s) {
  if (!state || state.ended !== s.ended) showEnd(s.ended);
  state = s;
  showTable(s.publication);
  showSource(s);
  showPace(s.pace);
  showEncoders(s.encoders);
  showMeasured(s);
  showVerdict(s.verdict);
  showGap(s);
}

// ---- commands

function answer(text, bad) {
  by("answer").className = bad ? "bad" : "";
  put("answer", text);
}

async function command(name, button) {
  button.disabled = true;
  answer("…");
  try {
    const response = await fetch("/api/command/" + name, { method: "POST" });
    const said = await response.json();
    answer(said.done || said.error, !response.ok);
  } catch (error) {
    answer("the program does not answer: " + error.message, true);
  }
  button.disabled = false;
}

function ask(title, text, then) {
  put("ask-title", title);
  put("ask-text", text);
  by("ask-yes").onclick = () => { by("ask").close(); then(); };
  by("ask").showModal();
  by("ask-no").focus();
}

by("ask-no").onclick = () => by("ask").close();
by("pause").onclick = () => command(state && state.paused ? "continue" : "pause", by("pause"));
by("save").onclick = () => command("save", by("save"));
by("reset").onclick = () => ask("Reset the estimator?", "η and λ are forgotten and learned anew. The journal keeps all measurements.", () => command("reset", by("reset")));
by("reference").onclick = () => ask("Take the straight reference?", "The snake must be straight in the picture now. Camera and grid are calibrated anew from it, and rig.toml is written.", () => command("reference", by("reference")));
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("dialog, button, summary, a")) return;
  if (event.key === "p") by("pause").click();
  if (event.key === "s") by("save").click();
});

// ---- what comes

const events = new EventSource("/api/events");
events.addEventListener("state", (event) => {
  chip("chip-link", "good", "page: live");
  show(JSON.parse(event.data));
});
events.addEventListener("rows", (event) => plots.add(JSON.parse(event.data)));
events.onerror = () => chip("chip-link", "bad", "page: no connection");
// The picture's stream does not come back by itself.
// A lost picture's place stays empty until it is asked for again.
by("video").onerror = () => {
  by("video").style.visibility = "hidden";
  setTimeout(() => {
    by("video").style.visibility = "visible";
    by("video").src = "/video.mjpg?" + Date.now();
  }, 2000);
};
setInterval(plots.draw, 500);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", plots.draw);
