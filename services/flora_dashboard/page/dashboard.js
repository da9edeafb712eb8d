// The page: takes each new view from the server and draws it. Texts from the bus are only ever set as text.
import { drawCourses, drawPath } from "./charts.js";
import { drawOverlay } from "./overlay.js";

const HISTORY_RETRY_MS = 5000;
const byId = (id) => document.getElementById(id);
let view = null;
let rows = [];
let rowsEnd = 0;
let rowsOf = "";
let isFetching = false;
let isConnected = false;

function element(name, text = "", className = "") {
  const made = document.createElement(name);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

const message = (kind) => view.last[kind]?.message ?? null;
const percent = (share) => (share === null || share === undefined ? "–" : `${(100 * share).toFixed(1)} %`);
const hours = (seconds) => (seconds / 3600).toFixed(1);

function span(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  if (seconds < 120) return `${Math.round(seconds)} s`;
  if (seconds < 7200) return `${Math.round(seconds / 60)} min`;
  if (seconds < 172800) return `${hours(seconds)} h`;
  return `${(seconds / 86400).toFixed(1)} d`;
}

function showHead() {
  const tick = message("tick");
  document.title = `${view.rig} – flora`;
  byId("rig").textContent = view.rig;
  byId("run").textContent = view.plant ? `${view.run}: ${view.plant}` : view.run;
  byId("hour").textContent = tick ? `hour ${hours(tick.time_s)}` : "";
  const chip = byId("well");
  const problems = view.concerns.filter((one) => one.level === "problem").length;
  const worst = !isConnected || problems ? "problem" : view.concerns.some((one) => one.level === "notice") ? "notice" : "good";
  chip.className = `chip ${worst}`;
  chip.textContent = !isConnected ? "no connection to flora-dashboard" : problems ? `${problems} problem${problems > 1 ? "s" : ""}` : "all well";
}

function showPicture() {
  const image = byId("photograph");
  const camera = view.camera;
  if (camera) byId("stage").style.aspectRatio = `${camera.width_px} / ${camera.height_px}`;
  const frame = view.photograph;
  if (frame && image.dataset.sha256 !== frame.sha256) {
    image.dataset.sha256 = frame.sha256;
    image.src = `photographs/${frame.sha256}`;
  }
  const stem = message("stem");
  const told = [];
  if (frame) {
    const lamp = { left: "left lamp", right: "right lamp", both: "both lamps", dark: "no lamp" }[frame.light];
    told.push(`tick ${frame.tick}, hour ${hours(frame.time_s)}, ${lamp}`);
  }
  if (stem && stem.outcome === "no_frame") told.push("no photograph has come since");
  else if (stem) {
    const doubt = stem.uncertainty_mm.length ? ` ± ${stem.uncertainty_mm.at(-1).toFixed(1)} mm` : "";
    const tip = stem.points_cm.length ? `, tip (${stem.points_cm.at(-1).map((v) => v.toFixed(2)).join(", ")}) cm${doubt}` : "";
    const which = view.is_measured ? "stem" : "stem of an earlier photograph";
    told.push(`${which}: ${stem.outcome.replaceAll("_", " ")}${tip}${stem.folded ? ", folded" : ""}, ${stem.took_ms.toFixed(0)} ms`);
  }
  byId("caption").textContent = told.join(" · ");
  drawOverlay(byId("overlay"), view, byId("show-overlay").checked);
}

function showNow() {
  const lamps = message("lamps");
  const light = message("light");
  const controller = message("controller");
  const lit = lamps ? lamps.lit : "dark";
  for (const side of ["left", "right"]) byId(`lamp-${side}`).classList.toggle("lit", lit === side || lit === "both");
  byId("light").textContent = lamps ? `${lamps.current_a.toFixed(1)} A` + (lamps.scale < 1 ? `, dimmed to ${percent(lamps.scale)}` : "") : "lamps not heard";
  const facts = [];
  if (controller) {
    facts.push(["steers", controller.controller]);
    facts.push(["fitness", `${percent(controller.fitness)}, best ${percent(controller.best_fitness)}`]);
    if (controller.clearance_cm !== null) facts.push(["nearest to the obstacle", `${controller.clearance_cm.toFixed(1)} cm`]);
    facts.push(["changes of lamp", controller.switches]);
    if (controller.shadow) facts.push(["in shadow", `${controller.shadow}, agrees ${percent(controller.shadow_agree)}`]);
  }
  if (light) facts.push(["network's output", light.output.toFixed(2) + (light.blind ? " (blind)" : "")]);
  const stored = message("stored");
  if (stored) facts.push(["at the NAS", `${stored.stored} files, ${stored.waiting} waiting`]);
  const recording = message("recording");
  if (recording) facts.push(["recorded", `${recording.messages} ${recording.messages === 1 ? "message" : "messages"}, ${(recording.bytes / 1048576).toFixed(1)} MiB`]);
  const departure = message("departure");
  if (departure && departure.run === view.run) {
    facts.push(["against its simulation", `tip ${departure.tip_error_mm.toFixed(0)} mm off, ${departure.expected_mm.toFixed(0)} mm expected`]);
  }
  const job = message("job_progress");
  if (job && (job.stage === "working" || job.stage === "waiting")) {
    facts.push(["at the lab", [job.work, job.stage === "waiting" ? "waits" : job.text, job.share === null ? "" : percent(job.share)].filter(Boolean).join(", ")]);
  }
  byId("facts").replaceChildren(...facts.flatMap(([name, value]) => [element("dt", name), element("dd", value)]));
  const told = view.concerns.map((one) => element("li", one.text, one.level));
  byId("concerns").replaceChildren(...(told.length ? told : [element("li", "Nothing: all is as it should be.", "good")]));
}

function showServices() {
  const lines = view.services.map((one) => {
    const line = element("tr", "", one.ok ? "well" : one.state === "never heard" ? "absent" : "bad");
    const state = one.reason && !one.ok ? `${one.state}: ${one.reason}` : one.state;
    line.append(
      element("td", one.name), element("td", state, "state"), element("td", span(one.age_s)), element("td", span(one.uptime_s)),
      element("td", `${one.resident_mib} MiB`), element("td", one.gaps), element("td", one.bad),
    );
    return line;
  });
  byId("services").replaceChildren(...lines);
}

function showCharts() {
  drawPath(byId("path"), rows, view);
  drawCourses([byId("sideways"), byId("height"), byId("fitness")], rows, view, byId("under-pointer"));
}

async function fetchRows() {
  if (isFetching || !view) return;
  if (rowsOf !== view.run || rowsEnd > view.rows_end) [rows, rowsEnd, rowsOf] = [[], 0, view.run];
  if (rowsEnd >= view.rows_end) return;
  isFetching = true;
  try {
    const answer = await fetch(`api/history?from=${rowsEnd}`);
    if (!answer.ok) throw new Error(answer.statusText);
    const more = await answer.json();
    rows = more.begin > rowsEnd ? more.rows : rows.concat(more.rows);
    rowsEnd = more.begin + more.rows.length;
    showCharts();
  } catch {
    setTimeout(fetchRows, HISTORY_RETRY_MS);
  } finally {
    isFetching = false;
  }
}

function show(next) {
  view = next;
  showHead();
  showPicture();
  showNow();
  showServices();
  fetchRows();
}

function listen() {
  const events = new EventSource("api/events");
  events.onmessage = (event) => {
    isConnected = true;
    show(JSON.parse(event.data));
  };
  events.onerror = () => {
    isConnected = false;
    if (view) showHead();
    else byId("well").textContent = "no connection to flora-dashboard";
    if (events.readyState === EventSource.CLOSED) setTimeout(listen, HISTORY_RETRY_MS);
  };
}

const image = byId("photograph");
image.addEventListener("load", () => { image.hidden = false; byId("no-photograph").hidden = true; });
image.addEventListener("error", () => {
  image.hidden = true;
  byId("no-photograph").hidden = false;
  byId("no-photograph").textContent = "The photograph is not on this machine any more";
});
byId("show-overlay").addEventListener("change", () => view && showPicture());
window.addEventListener("resize", () => view && showCharts());
listen();
