// A moving surface with a play button and a time slider. Called with the id of its figure and what
// `esfem_core.output.viewer` has written: numbers are 16 bits each, evenly spaced in a range.
(function (id, film) {
  "use strict";
  // A picture that is shown twice has one id: it is the one around the script, or, where a notebook
  // runs scripts elsewhere, the first that has none yet.
  const running = document.currentScript;
  const figure = (running && running.closest(".esfem-animation")) ||
    [...document.querySelectorAll(".esfem-animation")].find((f) => f.id === id && !f.dataset.begun);
  figure.dataset.begun = "yes";
  const [stage, button, slider, clock] = [
    ".esfem-stage", "button", "input", "output",
  ].map((part) => figure.querySelector(part));

  const bytes = (text) => Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0)).buffer;
  const numbers = (text, [low, high]) =>
    Float64Array.from(new Uint16Array(bytes(text)), (n) => low + (n / 65535) * (high - low));

  // What changes from one frame to the next, as plotly wants it.
  function moving(k) {
    const part = {};
    ["x", "y", "z", "intensity"].forEach((key, i) => {
      part[key] = numbers(film.frames[k][i], film.ranges[i]);
    });
    (film.triangles[k] || []).forEach((corners, i) => {
      part["ijk"[i]] = new Uint32Array(bytes(corners));
    });
    return part;
  }

  let now = 0;
  let playing = false;
  let started = null; // the picture, as soon as somebody comes near it
  let drawing = false;

  // One copy of plotly for all pictures of a page.
  function plotly() {
    if (window.Plotly) return Promise.resolve();
    if (!window.esfemPlotly) {
      window.esfemPlotly = new Promise((done, failed) => {
        const script = document.createElement("script");
        Object.assign(script, { src: film.plotly, onload: done, onerror: failed });
        document.head.append(script);
      });
    }
    return window.esfemPlotly;
  }

  async function draw() {
    await plotly();
    const trace = Object.assign(moving(0), film.trace);
    const plain = { responsive: true, displayModeBar: false, scrollZoom: false };
    await Plotly.newPlot(stage, [trace], film.layout, plain);
    figure.classList.add("esfem-drawn");
  }

  function start() {
    started = started || draw();
    return started;
  }

  function point(k) {
    now = k;
    slider.value = k;
    clock.textContent = "t = " + film.times[k];
    slider.setAttribute("aria-valuetext", clock.textContent);
  }

  // Draw the newest frame asked for; those asked for while one is being drawn are left out.
  async function show(k) {
    point(k);
    if (drawing) return;
    drawing = true;
    await start();
    for (let drawn = -1; drawn !== now; ) {
      drawn = now;
      const change = {};
      Object.entries(moving(drawn)).forEach(([key, values]) => { change[key] = [values]; });
      await Plotly.restyle(stage, change, [0]);
    }
    drawing = false;
  }

  function pause() {
    playing = false;
    button.textContent = "play";
  }

  async function play() {
    playing = true;
    button.textContent = "pause";
    await start();
    if (now === film.times.length - 1) await show(0);
    while (playing && now < film.times.length - 1) {
      const due = performance.now() + film.duration;
      await show(now + 1);
      await new Promise((done) => setTimeout(done, Math.max(0, due - performance.now())));
    }
    pause();
  }

  // plotly keeps the wheel for itself even where it does not zoom: it is to move the page.
  stage.addEventListener("wheel", (event) => event.stopPropagation(), { capture: true, passive: true });
  button.addEventListener("click", () => (playing ? pause() : play()));
  slider.addEventListener("input", () => {
    pause();
    show(Number(slider.value));
  });
  slider.max = film.times.length - 1;
  point(0);
  figure.querySelector(".esfem-controls").hidden = film.times.length < 2;

  // Drawn when near, played once when seen, unless the reader's system asks for no motion.
  const when = (options, action) => {
    const watch = new IntersectionObserver((entries) => {
      if (entries.some((entry) => entry.isIntersecting)) {
        watch.disconnect();
        action();
      }
    }, options);
    watch.observe(stage);
  };
  when({ rootMargin: "300px" }, start);
  if (film.times.length > 1 && !matchMedia("(prefers-reduced-motion: reduce)").matches) {
    when({ threshold: 0.6 }, () => { if (now === 0 && !playing) play(); });
  }
})
