"""How a scheduler of Dask is reached: its address, the library, and a client of it."""

from __future__ import annotations

import logging
import signal
import threading
import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from ...merl_io.source import MerlError

if TYPE_CHECKING:
    from distributed import Client
    from distributed.security import Security

SCHEMES = {"dask": "tcp", "dask+tls": "tls"}
SLURM = "dask-slurm"
CONNECT = 5.0  # seconds for a scheduler to answer
UNHEARD = logging.CRITICAL + 1  # level of what Dask logs: what matters is said in lines of ours


class ClusterError(MerlError):
    """A cluster that cannot be used; the message is one line with the mend."""


def library(name: str, where: str, extra: str) -> Any:  # noqa: ANN401 - a module
    """Import a library that an extra of merlfit brings; Ctrl-C means afterwards what it meant before.

    Raises:
        ClusterError: it is not installed.
    """
    handler = signal.getsignal(signal.SIGINT)
    try:
        return import_module(name)
    except ModuleNotFoundError:
        raise ClusterError(
            f"--executor {where} needs {name}, which is not installed: pip install 'merlfit[{extra}]'"
        ) from None
    finally:  # dask_jobqueue sets a handler of its own, which ends the program with exit code 0
        if handler is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, handler)


def address_of(where: str) -> str:
    """As Dask writes it.

    Raises:
        ClusterError: it is none.
    """
    try:
        parts = urlsplit(where)
        if parts.scheme in SCHEMES and parts.hostname and parts.port:
            return f"{SCHEMES[parts.scheme]}://{parts.netloc}"
    except ValueError:  # of the port
        pass
    raise ClusterError(f"--executor {where!r} should be dask://HOST:PORT, dask+tls://HOST:PORT or {SLURM}")


def connected(where: str, address: str, security: Security | None = None) -> Client:
    """A client of a scheduler that can take files.

    Raises:
        ClusterError: no scheduler answers, or it has no merlfit.
    """
    from distributed import Client
    from distributed.security import Security
    from distributed.versions import VersionMismatchWarning

    from .slot import present

    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(UNHEARD)
    warnings.simplefilter("ignore", VersionMismatchWarning)  # a table
    warnings.filterwarnings("ignore", "Sending large graph")  # a file, where workers do not see it
    client, security = None, security or Security()
    try:
        certified: Any = security.get_connection_args("client")["ssl_context"]
        if address.startswith("tls") and certified is None:  # a client that fails for want of them leaves a traceback
            raise ValueError("distributed.comm.tls in Dask's configuration lacks ca-file, client.cert or client.key")
        client = Client(address, timeout=CONNECT, set_as_default=False, security=security)
        client.run_on_scheduler(present, callback_timeout=CONNECT)
    except Exception as error:  # of whatever kind: no address, no answer, no certificates, no merlfit
        if client is not None:
            client.close(timeout=CONNECT)
        raise ClusterError(
            f"{where}: no scheduler there takes files ({type(error).__name__}: {line(error)}); start one with `dask "
            "scheduler`, install there what is here, or check host, port, firewall and TLS"
        ) from None
    return client


def line(error: BaseException) -> str:
    """The first of what an error says."""
    return (str(error).splitlines() or [""])[0]
