// Small helps of the pages. Without this script nothing is missing but comfort.
(function () {
  "use strict";

  // What is wider than its place: it can be scrolled by keyboard, and says which side is hidden.
  const SCROLLS =
    'mjx-container[display="true"], .esfem-table, .pst-scrollable-table-container, .cell_output, .highlight pre';

  function look(box) {
    const room = box.scrollWidth - box.clientWidth;
    const wide = room > 2 && box.clientWidth > 0;
    const sides = [];
    if (wide && box.scrollLeft > 2) sides.push("left");
    if (wide && box.scrollLeft < room - 2) sides.push("right");
    if (sides.length) box.dataset.hidden = sides.join(" ");
    else delete box.dataset.hidden;
    if (wide && !box.hasAttribute("tabindex")) {
      box.tabIndex = 0;
      if (!box.hasAttribute("role")) box.setAttribute("role", "region");
      box.setAttribute("aria-label", "wider than the page: scrolls sideways");
    } else if (!wide && box.getAttribute("role") === "region") {
      ["tabindex", "role", "aria-label"].forEach((name) => box.removeAttribute(name));
    }
  }

  function watch(box) {
    box.addEventListener("scroll", () => look(box), { passive: true });
    new ResizeObserver(() => look(box)).observe(box);
  }

  // What has the width of a line: the words around a formula may have none of their own.
  const around = (formula) =>
    formula.closest("p, li, td, dd, figcaption, h1, h2, h3") || formula.parentElement;

  // A formula in a line that is longer than the line.
  function inline(formula) {
    const place = around(formula);
    const wide = formula.firstElementChild;
    if (wide && wide.getBoundingClientRect().width > place.clientWidth && place.clientWidth > 0) {
      formula.classList.add("esfem-wide");
      watch(formula);
    }
  }

  const whole = (text) =>
    Object.assign(document.createElement("span"), { className: "esfem-whole", textContent: text });

  // Numbers such as 4.8e-02 in tables are not broken at the minus.
  function numbers(cell) {
    const walker = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT);
    const texts = [];
    while (walker.nextNode()) texts.push(walker.currentNode);
    for (const text of texts) {
      const parts = text.nodeValue.split(/([-+−]?\d[\d.]*e[-+]\d+)/);
      if (parts.length > 1) text.replaceWith(...parts.map((part, i) => (i % 2 ? whole(part) : part)));
    }
  }

  // What follows a formula without a space stays on its line.
  function tie(formula) {
    const next = formula.nextSibling;
    const sign = next && next.nodeType === Node.TEXT_NODE && next.nodeValue.match(/^[,.;:)\]!?]+/);
    const room = around(formula).clientWidth - formula.getBoundingClientRect().width;
    if (!sign || room < 20) return;
    const both = whole("");
    formula.before(both);
    next.nodeValue = next.nodeValue.slice(sign[0].length);
    both.append(formula, sign[0]);
  }

  function ready() {
    document.querySelectorAll(":is(.esfem-table, .esfem-claim) td").forEach(numbers);
    document.querySelectorAll(SCROLLS).forEach(watch);
    document.querySelectorAll("span.math").forEach(inline);
    document.querySelectorAll("span.math").forEach(tie);
  }
  const formulas = window.MathJax && MathJax.startup && MathJax.startup.promise;

  // A browser goes to the place that a link names before formulas have their height: once more
  // then, if the reader has not gone on by himself.
  let gone = false;
  ["wheel", "touchmove", "pointerdown", "keydown"].forEach((kind) =>
    addEventListener(kind, () => { gone = true; }, { passive: true }),
  );
  addEventListener("hashchange", () => { gone = false; });
  function again() {
    const place = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (place && !gone) place.scrollIntoView({ behavior: "instant" });
  }
  const loaded = new Promise((done) => {
    if (document.readyState === "complete") done();
    else addEventListener("load", done);
  });
  Promise.resolve(formulas).then(ready).then(again);
  Promise.all([formulas, loaded, document.fonts.ready]).then(again);

  // Paper is white.
  const page = document.documentElement;
  let theme;
  addEventListener("beforeprint", () => {
    theme = page.dataset.theme;
    page.dataset.theme = "light";
  });
  addEventListener("afterprint", () => { page.dataset.theme = theme; });

  // Filters of the claims ledger.
  const title = (page) => {
    const link = document.querySelector(`.bd-links a[href$="${page}.html"]`);
    return link ? link.textContent.trim() : page;
  };
  const named = (row, prefix) =>
    [...row.classList].filter((c) => c.startsWith(prefix)).map((c) => c.slice(prefix.length))[0];
  const FILTERS = {
    paper: (row) => (row.textContent.match(/^\s*(LMV|N)-/) || [])[1],
    chapter: (row) => named(row, "in-"),
    verdict: (row) => row.querySelector(".esfem-verdict").textContent.trim(),
    evidence: (row) => named(row, "kind-"),
  };

  function filters(tables) {
    const rows = tables.flatMap((table) => [...table.querySelectorAll("tbody tr")]);
    const form = document.createElement("form");
    form.className = "esfem-filters";
    form.setAttribute("aria-label", "show some of the claims");
    const chosen = {};
    for (const [name, of] of Object.entries(FILTERS)) {
      const values = [...new Set(rows.map(of))].filter(Boolean).sort();
      const options = values.map((v) => {
        const shown = name === "chapter" ? title(v) : name === "paper" ? `[${v}]` : v;
        return new Option(shown, v);
      });
      const label = document.createElement("label");
      chosen[name] = document.createElement("select");
      chosen[name].append(new Option("all", ""), ...options);
      label.append(name, chosen[name]);
      form.append(label);
    }
    const again = Object.assign(document.createElement("button"), { type: "reset", textContent: "show all" });
    const count = document.createElement("output");
    form.append(again, count);
    const apply = () => {
      for (const row of rows) {
        row.hidden = Object.entries(FILTERS).some(
          ([name, of]) => chosen[name].value && of(row) !== chosen[name].value,
        );
      }
      const own = rows.filter((row) => row.id); // a claim that failed stands in two tables
      count.textContent = `${own.filter((row) => !row.hidden).length} of ${own.length} claims`;
    };
    form.addEventListener("change", apply);
    form.addEventListener("reset", () => setTimeout(apply));
    apply();
    const heading = tables[0].closest("section").querySelector("h2");
    heading.parentElement.before(form);
  }

  const tables = [...document.querySelectorAll(".esfem-ledger")];
  if (tables.length) filters(tables);
})();
