/** The HTTP interface, to read and to try: Swagger UI over the service's own OpenAPI document. */

/* global SwaggerUIBundle */
SwaggerUIBundle({
  dom_id: "#docs",
  url: "/openapi.json",
  deepLinking: true,
  validatorUrl: null, // It would send the document elsewhere.
  defaultModelsExpandDepth: 0,
});
