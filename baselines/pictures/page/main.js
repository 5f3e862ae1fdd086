// The page: views in step, slider and keys, curves, what was tried.

const PLAY_SECONDS = 7;
const TEXTS = {
  strain: (v) => v.toFixed(3),
  friction: (v) => (v === Infinity ? "lets go" : v.toFixed(2)),
  clearance: (v) => `${v.toFixed(1).replace("-", "\u2212")} mm`,
};

async function begin() {
  const page = JSON.parse(document.getElementById("data").textContent);
  const { palette, plans, squeeze } = page;
  const strains = strainColours(palette.STRAIN);
  const find = (selector) => document.querySelector(selector);
  const slider = find("#time");
  const playButton = find("#play");
  const state = { time: 0, playing: false, colour: "flap", through: false, top: 1, dirty: true };
  const motions = new Map(); // flaps by plan and what was tried, made when first seen

  // each view has its own, as a thing stands in one picture alone
  const flapOf = (view, plan, tried) => {
    const key = `${views.indexOf(view)}/${plan}/${tried ?? ""}`;
    const { motion } = tried ? plans[plan].tried[tried] : plans[plan];
    if (!motions.has(key)) motions.set(key, Flap.of(motion, palette, strains));
    return motions.get(key);
  };

  // --- views

  const views = [...document.querySelectorAll(".view")].map((holder) => ({
    holder, stage: null, flap: null, plan: Number(holder.dataset.plan), tried: null,
  }));

  const turned = (stage) => {
    if (state.turning) return;
    state.turning = true;
    for (const view of views) if (view.stage && view.stage !== stage) view.stage.lookAs(stage);
    state.turning = false;
    state.dirty = true;
  };

  function lookFrom(where) {
    const stages = views.map((view) => view.stage).filter(Boolean);
    stages[0]?.lookFrom(where, stages.flatMap((stage) => stage.places(where)));
  }

  async function put(view, plan, tried = null) {
    Object.assign(view, { plan, tried });
    const flap = await flapOf(view, plan, tried);
    if (view.plan !== plan || view.tried !== tried) return; // another one was asked for meanwhile
    const { name, colour, good, verdict } = plans[plan];
    const { title, scene = plans[plan].scene } = tried ? plans[plan].tried[tried] : plans[plan];
    const shown = tried ? `${name}, ${title}` : name;
    const found = tried ? "not certified: by the rod" : verdict;
    Object.assign(view, { flap, scene, shown });
    view.holder.style.setProperty("--plan", colour);
    const select = view.holder.querySelector("select");
    if (select) select.value = String(plan);
    const badge = view.holder.querySelector(".badge");
    badge.textContent = found;
    badge.classList.toggle("bad", !good && !tried);
    badge.classList.toggle("rod", Boolean(tried));
    const note = view.holder.querySelector(".note");
    note.hidden = !tried;
    note.querySelector("span").textContent = tried ? `${title[0].toUpperCase()}${title.slice(1)}, followed by the rod: quick and approximate, not certified.` : "";
    if (view.stage) {
      view.stage.furnish(scene);
      view.stage.put(flap);
      view.canvas.setAttribute("aria-label", `Three-dimensional picture of the flap, ${shown}. ${found}.`);
    }
    rescale();
    goTo(state.time); // which says what is shown
  }

  /** Colour scale and curves of what is shown now. */
  function rescale() {
    const shown = views.filter((view) => view.flap);
    const limits = shown.map((view) => view.scene.limits);
    const limit = Math.max(...limits.map((l) => l.strain));
    const greatest = Math.max(...shown.map((view) => view.flap.data.strainTop));
    state.top = find("#top").value === "limit" ? limit : greatest;
    find("#bar-top").textContent = state.top.toFixed(2);
    const at = Math.min(1, limit / state.top);
    find("#bar-limit").style.left = `${100 * at}%`;
    find("#bar-limit").hidden = limit > state.top * 1.001;
    find("#bar-limit-word").textContent = limit > state.top * 1.001 ? `limit ${limit}, beyond this scale` : `limit ${limit}`;
    for (const chart of charts) {
      chart.set(shown.map((view) => ({
        colour: plans[view.plan].colour,
        time: view.flap.data.time,
        values: view.flap.data.curves[chart.key],
        limit: view.scene.limits[chart.key],
        text: TEXTS[chart.key],
      })));
    }
    state.dirty = true;
  }

  const charts = ["strain", "friction", "clearance"].map((key) =>
    new Chart(find(`#chart-${key}`), key, key === "clearance", squeeze, (time) => { stop(); goTo(time); }));

  // --- time

  function said() {
    const last = Math.max(...views.map((view) => view.flap?.data.time.at(-1) ?? 0));
    const lifting = state.time > squeeze && last > squeeze;
    const share = lifting ? (state.time - squeeze) / (1 - squeeze) : Math.min(state.time, last) / squeeze;
    const where = `${lifting ? "lifting" : "jaws closing"}, ${Math.round(100 * share)} %`;
    const numbers = views.filter((view) => view.flap).map((view) => {
      const { time, curves } = view.flap.data;
      const of = (key) => {
        const value = valueAt(time, curves[key], state.time);
        return value === null ? "none yet" : TEXTS[key](value);
      };
      return `${view.shown}: strain ${of("strain")}, friction ${of("friction")}, clearance ${of("clearance")}`;
    });
    return { where, all: [where, ...numbers].join("; ") };
  }

  function goTo(time) {
    state.time = Math.min(1, Math.max(0, time));
    slider.value = String(Math.round(1000 * state.time));
    const { where, all } = said();
    slider.setAttribute("aria-valuetext", all);
    find("#where").textContent = where;
    state.dirty = true;
  }

  function play() {
    if (state.time >= 1) goTo(0);
    state.playing = true;
    playButton.textContent = "\u275A\u275A";
    playButton.setAttribute("aria-label", "Pause");
  }

  function stop() {
    state.playing = false;
    playButton.textContent = "\u25B6";
    playButton.setAttribute("aria-label", "Play");
  }

  playButton.addEventListener("click", () => (state.playing ? stop() : play()));
  slider.addEventListener("input", () => { stop(); goTo(Number(slider.value) / 1000); });
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const on = event.target.closest("select, input, textarea, button, summary, a");
    if (event.key === " " && (!on || on === slider)) {
      event.preventDefault();
      if (state.playing) stop();
      else play();
    }
    const steps = { ArrowLeft: -0.01, ArrowRight: 0.01, Home: -1, End: 1 };
    if (event.key in steps && (!on || on === slider || on.matches("button"))) {
      event.preventDefault();
      stop();
      goTo(state.time + steps[event.key]);
    }
    const stage = views.find((view) => view.canvas === event.target)?.stage;
    const turns = { a: [-0.1, 0], d: [0.1, 0], w: [0, 0.1], s: [0, -0.1], "+": [0, 0, 1.1], "-": [0, 0, 1 / 1.1] };
    if (stage && event.key in turns) stage.orbit(...turns[event.key]);
  });

  // --- looks

  for (const input of document.querySelectorAll("input[name=colour]")) {
    input.addEventListener("change", () => {
      state.colour = input.value;
      if (input.value === "veins") find("#through").checked = state.through = true;
      state.dirty = true;
    });
  }
  find("#through").addEventListener("change", (event) => {
    state.through = event.target.checked;
    state.dirty = true;
  });
  find("#top").addEventListener("change", rescale);
  for (const button of document.querySelectorAll("[data-look]")) {
    button.addEventListener("click", () => lookFrom(button.dataset.look));
  }
  for (const button of document.querySelectorAll("[data-orbit]")) {
    button.addEventListener("click", () => views[0].stage?.orbit(...button.dataset.orbit.split(" ").map(Number)));
  }

  // --- what was tried

  for (const button of document.querySelectorAll("button[aria-controls]")) {
    button.addEventListener("click", () => {
      const row = document.getElementById(button.getAttribute("aria-controls"));
      row.hidden = !row.hidden;
      button.setAttribute("aria-expanded", String(!row.hidden));
    });
  }
  for (const button of document.querySelectorAll("button[data-tried]")) {
    button.addEventListener("click", () => {
      const plan = Number(button.dataset.plan);
      const view = views.find((one) => one.plan === plan) ?? views[views.length - 1];
      put(view, plan, button.dataset.tried).then(() => {
        view.holder.scrollIntoView({ behavior: calm.matches ? "auto" : "smooth", block: "nearest" });
        goTo(0);
        play();
      });
    });
  }
  for (const view of views) {
    view.holder.querySelector(".note button").addEventListener("click", () => put(view, view.plan));
    view.holder.querySelector("select")?.addEventListener("change", (event) => put(view, Number(event.target.value)));
  }

  // --- drawing, only where something changed

  const bar = find("#bar").getContext("2d");
  for (let k = 0; k < 256; k++) {
    bar.fillStyle = `rgb(${strains.bytes.slice(3 * k, 3 * k + 3).join(" ")})`;
    bar.fillRect(k, 0, 1, 1);
  }

  const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
  let last = 0;
  function frame(now) {
    if (state.playing) {
      goTo(state.time + Math.min(0.1, (now - last) / 1000) / PLAY_SECONDS);
      if (state.time >= 1) stop();
    }
    last = now;
    if (state.dirty) {
      state.dirty = false;
      for (const view of views) {
        if (!view.stage || !view.flap) continue;
        view.stage.show(state.time, state);
        view.stage.render();
      }
      for (const chart of charts) chart.show(state.time);
    }
    requestAnimationFrame(frame);
  }

  for (const view of views) {
    view.canvas = view.holder.querySelector("canvas");
    try {
      view.stage = new Stage(view.holder, plans[view.plan].scene, palette, turned);
      new ResizeObserver(() => { view.stage.fit(); state.dirty = true; }).observe(view.canvas);
      view.stage.fit();
    } catch (problem) {
      view.holder.classList.add("flat");
      console.warn(`no three-dimensional picture: ${problem.message}`);
    }
  }
  await Promise.all(views.map((view) => put(view, view.plan)));
  lookFrom("corner");
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    for (const view of views) view.stage?.paintScheme();
    state.dirty = true;
  });
  goTo(0);
  requestAnimationFrame(frame);
  document.body.classList.add("ready");
  if (!calm.matches) play();
  window.retract = { state, views, goTo, stop, play }; // for the console, and for tests
}

begin().catch((problem) => {
  const notice = document.getElementById("failed");
  notice.hidden = false;
  notice.textContent = `The moving picture cannot be shown in this browser (${problem.message}); the numbers below are all the same.`;
});
