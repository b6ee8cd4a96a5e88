/** The page: its frame, and the view of the present route. */

import { useAway } from "./lib/connection.js";
import { html, render, useEffect, useRef, useState } from "./lib/html.js";
import { href, useRoute } from "./lib/route.js";
import { applyTheme, toggleTheme, useDark } from "./lib/theme.js";
import { Failure } from "./parts/states.js";

// Each view is loaded when it is first shown.
const VIEWS = {
  jobs: ({ path }) => (path.length ? import("./views/job.js") : import("./views/jobs.js")),
  compare: () => import("./views/compare.js"),
  sweeps: ({ path }) => (path.length ? import("./views/sweep.js") : import("./views/sweeps.js")),
  submit: () => import("./views/submit.js"),
  models: () => import("./views/models.js"),
  workers: () => import("./views/workers.js"),
};
const NAMES = { jobs: "Jobs", sweeps: "Sweeps", submit: "Submit", models: "Models", workers: "Workers" };

function useView(name, path) {
  const [view, setView] = useState({});
  const key = `${name}/${path.length > 0}`;
  useEffect(() => {
    let isWanted = true;
    VIEWS[name]({ path }).then(
      (module) => isWanted && setView({ key, Component: module.default }),
      (error) => isWanted && setView({ key, error }),
    );
    return () => (isWanted = false);
  }, [key]);
  return view.key === key ? view : {};
}

function Header({ present }) {
  const dark = useDark();
  return html`<header class="top">
    <a class="brand" href="#/jobs">Gaitway</a>
    <nav aria-label="Pages">
      ${Object.entries(NAMES).map(
        ([name, text]) =>
          html`<a href=${href([name])} aria-current=${name === present ? "page" : undefined}>${text}</a>`,
      )}
      <a href="/docs">HTTP</a>
    </nav>
    <button class="plain" type="button" onClick=${toggleTheme}>${dark ? "Light" : "Dark"}</button>
  </header>`;
}

function Banner() {
  if (!useAway()) return null;
  return html`<p class="banner" role="status">
    The service does not answer. What is shown is what was known last; the page goes on by itself as soon as it
    answers again.
  </p>`;
}

function App() {
  const route = useRoute();
  const [name = "jobs", ...path] = route.path;
  const main = useRef();
  const isKnown = name in VIEWS;
  const { Component, error } = useView(isKnown ? name : "jobs", path);
  useEffect(() => {
    document.title = name === "jobs" && !path.length ? "Gaitway" : `${NAMES[name] || "Compare"} · Gaitway`;
  }, [name, path[0]]);
  return html`
    <a class="skip" href="#main" onClick=${(event) => (event.preventDefault(), main.current.focus())}>To the content</a>
    <${Header} present=${name} />
    <${Banner} />
    <main id="main" ref=${main} tabindex="-1">
      ${!isKnown && html`<p class="state">There is no page “${name}”. <a href="#/jobs">To the jobs</a></p>`}
      ${isKnown && error && html`<${Failure} error=${error} again=${() => location.reload()} />`}
      ${isKnown && Component && html`<${Component} key=${path[0] || name} path=${path} query=${route.query} />`}
    </main>
  `;
}

applyTheme();
const root = document.getElementById("app");
root.textContent = "";
render(html`<${App} />`, root);
