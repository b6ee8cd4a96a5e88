/** Signing in: by the lab's identity provider where there is one, or by a token, typed once. */

import { post } from "../lib/api.js";
import { useSubmission } from "../lib/draft.js";
import { html, useEffect, useRef, useState } from "../lib/html.js";
import { useTitle } from "../lib/route.js";
import { signIn } from "../lib/session.js";
import { Prose } from "../parts/elements.js";

/** What a sign-in at the provider came to, which the service wrote into this very page. */
const refusal = document.querySelector('meta[name="refusal"]')?.content;
if (refusal) history.replaceState(null, "", `/${location.hash}`); // The address was the provider's answer.

/** provider: its name, or null. onDone: called once somebody is signed in. */
export default function SignIn({ provider, onDone }) {
  useTitle("Sign in");
  const [token, setToken] = useState("");
  const input = useRef();
  const { problem, isBusy, submit } = useSubmission(async () => (await signIn(token), onDone()), { token });
  useEffect(() => problem && input.current.focus(), [problem]);
  return html`<section class="card stack sign-in">
    <h1>Sign in</h1>
    ${refusal && html`<p class="error" role="alert"><${Prose} text=${refusal} /></p>`}
    ${provider && html`<${ByProvider} name=${provider} />`}
    <form class="stack" onSubmit=${submit} novalidate>
      <div class="field">
        <label for="token">${provider ? "Or with a token" : "Token"}</label>
        <input id="token" ref=${input} type="password" autocomplete="off" spellcheck="false" value=${token} placeholder="gaitway_…" onInput=${({ target }) => setToken(target.value)}
          aria-invalid=${problem ? "true" : undefined} aria-describedby=${problem ? "token-error token-about" : "token-about"} />
        ${problem && html`<p class="error" id="token-error" role="alert"><${Prose} text=${problem.message} /></p>`}
        <p class="facts" id="token-about">It is typed once; the browser then keeps a session, and not the token. An admin gives you one, or <code>gaitway tokens create</code> where you are logged in.</p>
      </div>
      <p class="actions"><button class=${provider ? "" : "main"} disabled=${isBusy || !token.trim()}>${isBusy ? "Signing in…" : "Sign in"}</button></p>
    </form>
  </section>`;
}

/** The provider sends the browser back to where it was. */
function ByProvider({ name }) {
  const start = async () => location.assign((await post("/session/oidc", { back: location.hash })).location);
  const { problem, isBusy, submit } = useSubmission(start, {});
  return html`<form onSubmit=${submit}>
    <p class="actions"><button class="main" disabled=${isBusy}>${isBusy ? "Asking…" : `Sign in with ${name}`}</button></p>
    ${problem && html`<p class="error" role="alert"><${Prose} text=${problem.message} /></p>`}
  </form>`;
}
