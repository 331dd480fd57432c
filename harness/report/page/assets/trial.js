"use strict";
// A trial, opened by any number that it is behind.

const dialog = document.getElementById("trial");

function measureOf(trial) {
  return report.measures[trial.e];
}

function trialName(trial) {
  const scene = trial.c >= 0 ? report.scenes[trial.c] : "";
  const parts = [report.methods[trial.d].label, report.materials[trial.m], scene, measureOf(trial)];
  return parts.filter(Boolean).join(" · ") + (trial.seed ? ` · seed ${trial.seed}` : "");
}

function sharedData(place) {
  return place >= 0 ? report.trials.shared[place] : "";
}

/** Open the trials at `places`; `about` is the number that they are behind, in words. */
function openTrials(places, about = "") {
  if (!places.length) return;
  dialog.replaceChildren();
  const close = button("Close", () => dialog.close(), { class: "close" });
  dialog.append(el("div", { class: "bar" }, el("b", {}, about || "Trial"), close));
  if (places.length > 1) {
    dialog.append(el("p", { class: "dim" }, `${places.length} trials are behind this number.`));
  }
  places.forEach((place, i) => {
    const trial = report.trials.list[place];
    const made = el("details", { class: "one", open: i === 0 }, el("summary", {}, trialName(trial)));
    const fill = () => { if (made.open && made.children.length === 1) made.append(trialBody(trial)); };
    made.addEventListener("toggle", fill);
    fill();
    dialog.append(made);
  });
  // Not showModal: it makes the whole page inert, which takes as long as a page has elements.
  if (!dialog.open) dialog.show();
  dialog.scrollTop = 0;
  const key = report.trials.list[places[0]].key;
  history.replaceState(null, "", `#trial=${key}`);
}

function trialBody(trial) {
  const body = el("div", {});
  const reason = sharedData(trial.reason);
  if (trial.status !== "ok") {
    body.append(el("p", { class: "warning" }, `${trial.status}${reason ? `: ${reason}` : ""}`));
  }
  if (trial.records.length) body.append(recordGrid(trial));
  body.append(el("h4", {}, "The command that repeats it"), commandLine(trial));
  const facts = [["key", trial.key], ["seed", trial.seed], ["training seed", trial.training]];
  if (trial.started) facts.push(["run", `${trial.started}, took ${brieflySeconds(trial.seconds)}`]);
  if (trial.shipped !== undefined) facts.push(["fit", `came with the harness: ${sharedData(trial.shipped)}`]);
  if (trial.state) facts.push(["fitted state", trial.state]);
  for (const [name, place] of [["raw arrays", trial.arrays], ["files", trial.files],
    ["documents", trial.documents]]) {
    const listed = place === undefined ? [] : sharedData(place);
    if (listed.length) facts.push([name, listed.join(", ")]);
  }
  body.append(el("h4", {}, "What was run"), described(facts));
  if (trial.fit !== undefined) {
    body.append(button("Open its fit", () => openTrials([trial.fit], "Fit"), { class: "plain" }));
  }
  for (const [name, place] of Object.entries(trial.about)) {
    if (name !== "seed") body.append(tree(name, sharedData(place)));
  }
  if (trial.effects !== undefined) body.append(tree("effects", sharedData(trial.effects)));
  body.append(el("h4", {}, "Machine and versions"), tree("environment", sharedData(trial.environment), true));
  if (trial.log !== undefined) {
    body.append(el("h4", {}, "Log"), el("pre", { tabindex: 0 }, sharedData(trial.log)));
  }
  return body;
}

function recordGrid(trial) {
  const head = ["metric", "value", "95% interval", "unit"];
  const rows = trial.records.map(([metric, value, low, high, unit]) => {
    const ends = low === null || high === null ? "" : `[${brief(low)}, ${brief(high)}]`;
    return el("tr", {}, el("th", { scope: "row" }, report.trials.metrics[metric]),
      el("td", {}, brief(value)), el("td", {}, ends), el("td", {}, report.trials.units[unit]));
  });
  return el("div", { class: "scroll" }, el("table", {},
    el("thead", {}, el("tr", {}, head.map((name) => el("th", { scope: "col" }, name)))),
    el("tbody", {}, rows)));
}

function commandLine(trial) {
  const labels = [["material", report.materials[trial.m]], ["method", report.methods[trial.d].label],
    ["measure", measureOf(trial)]];
  if (trial.c >= 0) labels.push(["scene", report.scenes[trial.c]]);
  const only = labels.map(([name, value]) => `${name}=${value}`).join(",");
  const quoted = /^[\w.,=/+-]+$/.test(only) ? only : `'${only.replace(/'/g, "'\\''")}'`;
  const text = `${report.command} --only ${quoted} --out results/again`;
  const copy = button("Copy", async () => {
    await navigator.clipboard.writeText(text);
    copy.textContent = "Copied";
  }, { class: "plain" });
  return el("div", { class: "command" }, el("code", {}, text), navigator.clipboard ? copy : null);
}

function described(pairs) {
  return el("dl", {}, pairs.map(([name, value]) => [el("dt", {}, name), el("dd", {}, String(value))]));
}

/** Nested plain data, folded. */
function tree(name, data, open = false) {
  if (data === null || typeof data !== "object") {
    return el("div", { class: "leaf" }, el("span", {}, `${name}: `), String(data));
  }
  const entries = Object.entries(data);
  if (!entries.length) return el("div", { class: "leaf" }, el("span", {}, `${name}: `), "none");
  if (entries.every(([, value]) => value === null || typeof value !== "object") && entries.length < 9) {
    const text = entries.map(([key, value]) => (Array.isArray(data) ? value : `${key} ${value}`)).join(", ");
    return el("div", { class: "leaf" }, el("span", {}, `${name}: `), text);
  }
  return el("details", { class: "tree", open }, el("summary", {}, name),
    entries.map(([key, value]) => tree(key, value)));
}

/** Keys and presses while a trial is open: it keeps the focus, and gives it back when it closes. */
function keepFocus() {
  document.addEventListener("keydown", (event) => {
    if (!dialog.open) return;
    if (event.key === "Escape") {
      event.preventDefault();
      dialog.close();
    }
    if (event.key !== "Tab") return;
    const inside = [...dialog.querySelectorAll(FOCUSABLE)].filter((one) => one.offsetParent !== null);
    const at = inside.indexOf(document.activeElement);
    const next = event.shiftKey ? at - 1 : at + 1;
    if (at >= 0 && next >= 0 && next < inside.length) return;
    event.preventDefault();
    inside[event.shiftKey ? inside.length - 1 : 0].focus();
  });
  // A press beside it closes it and does nothing else. Plots open trials before the press's click.
  let beside = false;
  document.addEventListener("pointerdown", (event) => { beside = dialog.open && !dialog.contains(event.target); }, true);
  document.addEventListener("click", (event) => {
    if (!beside) return;
    beside = false;
    event.stopPropagation();
    event.preventDefault();
    dialog.close();
  }, true);
}

function setUpTrials() {
  keepFocus();
  dialog.addEventListener("close", () => {
    if (location.hash.startsWith("#trial=")) history.replaceState(null, "", location.pathname);
  });
  const wanted = location.hash.startsWith("#trial=") ? location.hash.slice(7) : "";
  const place = report.trials.list.findIndex((trial) => trial.key === wanted);
  if (wanted && place >= 0) openTrials([place]);
}
