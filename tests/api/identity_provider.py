"""An identity provider: OpenID Connect over HTTP on a free port, which can also answer wrongly."""

import base64
import hashlib
import hmac
import json
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import parse_qsl, urlencode

import uvicorn
from fastapi import FastAPI, HTTPException, Request, Response
from fastapi.responses import JSONResponse, RedirectResponse
from joserfc import jwt
from joserfc.jwk import RSAKey

from api.main import listen

CLIENT, SECRET = "gaitway", "s3cret/+ with signs"


@dataclass
class Provider:
    """claims: of whoever signs in next. refuses: the error that it answers instead.

    forge: changes header and claims of an ID token before it is signed; sign: makes the token's text of both.
    is_broken: it answers 500 to all.
    """

    issuer: str
    claims: dict[str, Any] = field(default_factory=dict[str, Any])
    refuses: str | None = None
    is_broken: bool = False
    key: RSAKey = field(default_factory=lambda: RSAKey.generate_key(2048, auto_kid=True))
    forge: Callable[[dict[str, Any], dict[str, Any]], None] = lambda header, claims: None
    sign: Callable[[dict[str, Any], dict[str, Any]], str] | None = None
    asked: list[str] = field(default_factory=list[str])
    _codes: dict[str, dict[str, str]] = field(default_factory=dict[str, dict[str, str]])

    def app(self) -> FastAPI:
        app = FastAPI()

        @app.middleware("http")
        async def note(request: Request, call_next: Any) -> Response:
            self.asked.append(request.url.path)
            return JSONResponse({}, 500) if self.is_broken else await call_next(request)

        @app.get("/.well-known/openid-configuration")
        def metadata() -> dict[str, Any]:
            return {
                "issuer": self.issuer,
                "authorization_endpoint": f"{self.issuer}/authorize",
                "token_endpoint": f"{self.issuer}/token",
                "jwks_uri": f"{self.issuer}/keys",
                "id_token_signing_alg_values_supported": ["RS256", "HS256", "none"],
                "token_endpoint_auth_methods_supported": ["client_secret_basic"],
            }

        @app.get("/keys")
        def keys() -> dict[str, Any]:
            return {"keys": [self.key.as_dict(private=False)]}

        @app.get("/authorize")
        def authorize(request: Request) -> Response:
            asked = dict(request.query_params)
            assert (asked["client_id"], asked["response_type"]) == (CLIENT, "code")
            assert asked["code_challenge_method"] == "S256"
            answer = {"state": asked["state"], "session_state": "0"}
            if self.refuses is not None:
                answer |= {"error": self.refuses, "error_description": "the user said no"}
            else:
                answer["code"] = secrets.token_hex(8)
                self._codes[answer["code"]] = asked
            return RedirectResponse(f"{asked['redirect_uri']}?{urlencode(answer)}", 302)

        @app.post("/token")
        async def token(request: Request) -> Any:
            form = dict(parse_qsl((await request.body()).decode()))
            code_verifier, redirect_uri = form["code_verifier"], form["redirect_uri"]
            asked = self._codes.pop(form["code"], None)
            challenge = base64.urlsafe_b64encode(hashlib.sha256(code_verifier.encode()).digest())
            sent = base64.b64decode(request.headers["authorization"].partition(" ")[2]).decode()
            if sent != "gaitway:s3cret%2F%2B%20with%20signs":
                raise HTTPException(401)
            if (
                asked is None
                or asked["redirect_uri"] != redirect_uri
                or challenge.decode().rstrip("=") != asked["code_challenge"]
            ):
                return JSONResponse({"error": "invalid_grant"}, 400)
            return {"access_token": "unused", "token_type": "Bearer", "id_token": self._id_token(asked)}

        return app

    def _id_token(self, asked: dict[str, str]) -> str:
        now = int(time.time())
        header: dict[str, Any] = {"alg": "RS256", "kid": self.key.kid}
        claims = {"iss": self.issuer, "aud": CLIENT, "nonce": asked["nonce"], "iat": now, "exp": now + 60}
        claims |= self.claims
        self.forge(header, claims)
        if self.sign is not None:
            return self.sign(header, claims)
        return jwt.encode(header, claims, self.key)


def unsigned(header: dict[str, Any], claims: dict[str, Any]) -> str:
    """A token of the algorithm `none`."""
    return f"{_encoded({**header, 'alg': 'none'}, claims)}."


def signed_by_hmac(header: dict[str, Any], claims: dict[str, Any], key: str) -> str:
    """A token that whoever has the key can make; by hand, since joserfc refuses a public key here."""
    text = _encoded({**header, "alg": "HS256"}, claims)
    return f"{text}.{_base64(hmac.digest(key.encode(), text.encode(), 'sha256'))}"


def _encoded(*parts: dict[str, Any]) -> str:
    return ".".join(_base64(json.dumps(part).encode()) for part in parts)


def _base64(content: bytes) -> str:
    return base64.urlsafe_b64encode(content).decode().rstrip("=")


@contextmanager
def provided() -> Iterator[Provider]:
    """A running provider."""
    with listen("127.0.0.1", 0) as listener:
        provider = Provider(f"http://127.0.0.1:{listener.getsockname()[1]}")
        server = uvicorn.Server(uvicorn.Config(provider.app(), log_config=None, lifespan="off"))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        yield provider
        server.should_exit = True
        thread.join(20)
        assert not thread.is_alive()
