"use strict";
// The suites below each other: title, what they say, what holds.

setUpTheme();
const place = el("div", { class: "suites" });
const find = el("input", { type: "search", placeholder: "words that a suite has", "aria-label": "Filter suites",
  on: { input: () => drawSuites() } });
document.getElementById("main").append(el("div", { class: "form" }, find), place);

function drawSuites() {
  const words = find.value.toLowerCase().split(/\s+/).filter(Boolean);
  const seen = report.suites.filter((suite) => words.every((word) => JSON.stringify(suite).toLowerCase().includes(word)));
  place.replaceChildren(...seen.map((suite) => el("section", { class: "suite" },
    el("h2", {}, suite.page ? el("a", { href: suite.page.split("/").map(encodeURIComponent).join("/") }, suite.title) : suite.title),
    el("p", { class: "facts" }, [suite.name, ...(suite.facts || [])].join(" · ")),
    suite.why ? el("p", { class: "warning" }, suite.why) : null,
    suite.status ? el("p", { class: suite.holds ? "dim" : "warning" }, suite.status) : null,
    (suite.sentences || []).map((text) => el("p", {}, text)))));
}

drawSuites();
document.documentElement.dataset.ready = "yes";
