/** The page: its frame, and the view of the present route. */

import { get, useAway } from "./lib/api.js";
import { docsOf, href, useRoute } from "./lib/route.js";
import { html, render, useEffect, useRef, useState } from "./lib/html.js";
import { useCurrentInSight } from "./lib/in_sight.js";
import { useLive } from "./lib/live.js";
import { useSession } from "./lib/session.js";
import { applyTheme, toggleTheme, useDark } from "./lib/theme.js";
import { Failure, Loading } from "./parts/elements.js";

// The module of each view, which is loaded when it is first shown.
const VIEWS = {
  jobs: ([id]) => (id ? "job" : "jobs"),
  compare: () => "compare",
  sweeps: ([id]) => (id === "new" ? "new_sweep" : id ? "sweep" : "sweeps"),
  submit: () => "submit",
  models: () => "models",
  clips: () => "clips",
  workers: () => "workers",
  usage: () => "usage",
  news: () => "news",
  account: () => "account",
};
const NAMES = { jobs: "Jobs", sweeps: "Sweeps", submit: "Submit", models: "Models", clips: "Clips", workers: "Workers", usage: "Usage", news: "News" };

function useView(key) {
  const [view, setView] = useState({});
  useEffect(() => {
    let isWanted = true;
    import(`./views/${key}.js`).then(
      (module) => isWanted && setView({ key, Component: module.default }),
      (error) => isWanted && setView({ key, error }),
    );
    return () => (isWanted = false);
  }, [key]);
  return view.key === key ? view : {};
}

function Header({ present, session }) {
  const dark = useDark();
  return html`<header class="top">
    <a class="brand" href="#/jobs">Gaitway</a>
    <nav aria-label="Pages" ref=${useCurrentInSight(present)}>
      ${Object.entries(session?.accounts && !session.who ? {} : NAMES).map(
        ([name, text]) =>
          html`<a href=${href([name])} aria-current=${name === present ? "page" : undefined}>${text}</a>`,
      )}
      <a href="/docs">HTTP</a>
      <a href=${docsOf(present)} target="_blank" rel="noopener" title="The documentation, on another host">Docs</a>
    </nav>
    ${session?.accounts && session.who && html`<a class="who" href="#/account" title="Your account" aria-current=${present === "account" ? "page" : undefined}>${session.who.user}</a>`}
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

/** A view whose module did not arrive. After an outage the page loads itself again: browsers keep a failed import. */
function Unloaded({ error }) {
  const wasAway = useRef(false);
  const { data, error: outage, again } = useLive((signal) => get("/jobs", { limit: 1 }, { signal }), []);
  if (outage) wasAway.current = true;
  useEffect(() => {
    if (data && wasAway.current) location.reload();
  }, [data]);
  if (outage) return html`<${Failure} error=${outage} again=${again} />`;
  return data ? html`<${Failure} error=${error} again=${() => location.reload()} />` : html`<${Loading} what="the view" />`;
}

function App() {
  const route = useRoute();
  const [name = "jobs", ...path] = route.path;
  const main = useRef();
  const isKnown = name in VIEWS;
  const { session, again } = useSession();
  const isOut = session?.accounts && !session.who;
  const { Component, error } = useView(isOut ? "sign_in" : VIEWS[isKnown ? name : "jobs"](path));
  const isOne = path.length > 0 && path[0] !== "new"; // One job or sweep, whose view says how it goes.
  useEffect(() => {
    if (!isOne && name !== "account" && !isOut) document.title = `${path[0] === "new" ? "New sweep" : NAMES[name] || "Compare"} · Gaitway`;
  }, [name, isOne, path[0], isOut]);
  return html`
    <a class="skip" href="#main" onClick=${(event) => (event.preventDefault(), main.current.focus())}>To the content</a>
    <${Header} present=${name} session=${session} />
    <${Banner} />
    <main id="main" ref=${main} tabindex="-1">
      ${isOut && Component && html`<${Component} provider=${session.provider} onDone=${again} />`}
      ${!isOut && !isKnown && html`<p class="state">There is no page “${name}”. <a href="#/jobs">To the jobs</a></p>`}
      ${(isKnown || isOut) && error && html`<${Unloaded} error=${error} />`}
      ${session && !isOut && isKnown && Component && html`<${Component} key=${`${session.who?.user} ${path[0] || name}`} path=${path} query=${route.query} />`}
    </main>
  `;
}

applyTheme();
const root = document.getElementById("app");
root.textContent = "";
render(html`<${App} />`, root);
