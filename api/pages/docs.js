/** The HTTP interface, to read and to try: Swagger UI over the service's own OpenAPI document. */

import { applyTheme, onTheme, toggleTheme } from "./lib/theme.js";

/* global SwaggerUIBundle */
SwaggerUIBundle({
  dom_id: "#docs",
  url: "/openapi.json",
  deepLinking: true,
  requestInterceptor: (request) => ((request.headers["X-Gaitway-Page"] = "1"), request), // As lib/api.js does.
  validatorUrl: null, // It would send the document elsewhere.
  defaultModelsExpandDepth: 0,
});

const button = document.getElementById("theme");
onTheme((dark) => {
  document.documentElement.classList.toggle("dark-mode", dark); // So Swagger UI calls it.
  button.textContent = dark ? "Light" : "Dark";
});
button.addEventListener("click", toggleTheme);
applyTheme();
