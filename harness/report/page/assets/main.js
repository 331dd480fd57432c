"use strict";
// The page from top to bottom.

function setUpPlots() {
  const any = report.convergence.length || report.charts.length || report.densities.materials.length
    || report.advice.cells.some((cell) => cell.fitted);
  if (!any) return;
  const place = section("plots", "Plots");
  setUpConvergence(place);
  setUpPareto(place);
  setUpBreakeven(place);
  setUpDensities(place);
}

function setUpFigures() {
  if (!report.figures.length) return;
  const details = el("details", {}, el("summary", {}, `${report.figures.length} figures for print, as PDF and PNG`));
  section("figures", "Print figures", details);
  const fill = () => {
    if (details.children.length > 1) return;
    for (const figure of report.figures) {
      const files = figure.files.map((file) => el("a", { href: `figures/${encodeURIComponent(file)}` }, file.split(".").pop()));
      details.append(el("figure", { class: "print" }, el("h3", {}, figure.title),
        figure.png ? el("div", { class: "scroll paper", tabindex: 0 }, el("img", { src: `data:image/png;base64,${figure.png}`,
          alt: figure.title, width: figure.width, height: figure.height })) : null,
        el("figcaption", {}, figure.caption, " ", el("span", { class: "files" }, files.flatMap((one, i) => (i ? [" · ", one] : [one]))))));
    }
  };
  details.addEventListener("toggle", () => { if (details.open) fill(); });
  // On paper they stand for the plots, of which those that were never in sight are not drawn.
  document.documentElement.dataset.figures = "yes";
  window.addEventListener("beforeprint", () => { fill(); details.open = true; });
}

function setUpCircumstances() {
  const place = section("about", "Trials and circumstances");
  for (const table of report.tables.filter((one) => one.name === "status")) {
    place.append(el("h3", {}, table.title), wholeTable(table));
  }
  if (report.skipped.length) {
    place.append(el("h3", {}, "Left out of this report"), el("ul", {}, report.skipped.map((line) => el("li", {}, line))));
  }
  place.append(el("h3", {}, "Circumstances"), el("ul", {}, report.circumstances.map((line) => el("li", {}, line))),
    el("p", {}, "The first command measures what is not stored yet and makes this report; the second makes it again from what is stored. The suite as run is ", el("a", { href: "../suite.yaml" }, "suite.yaml"), "."),
    el("pre", { tabindex: 0 }, `${report.command}\nharness report results/${report.suite}`));
}

/** What has images; else the last scene, since an environment map tells more than constant light. */
function firstChoice() {
  const group = report.images.groups[0];
  choice.material = group ? group.material : 0;
  choice.scene = group ? group.scene : report.scenes.length - 1;
}

setUpTheme();
firstChoice();
setUpFilters();
setUpAnswer();
setUpViewer();
setUpPlots();
setUpTables();
setUpRecords();
setUpFigures();
setUpCircumstances();
setUpTrials();
document.documentElement.dataset.ready = "yes";
