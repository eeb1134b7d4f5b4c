"""How a scheduler of Dask is reached: its address, the library, and a client of it."""

from __future__ import annotations

import re
import signal
import threading
import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from distributed import Client
    from distributed.security import Security

SCHEMES = {"dask": "tcp", "dask+tls": "tls"}
SLURM = "dask-slurm"
PORTS = range(1, 2**16)
CONNECT = 5.0  # seconds for a scheduler to answer


class ClusterError(ValueError):
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
        ClusterError: it is none, or TLS lacks certificates.
    """
    scheme, _, rest = where.partition("://")
    host, _, port = rest.rpartition(":")
    if scheme not in SCHEMES or not host or not re.fullmatch(r"[0-9]{1,5}", port) or int(port) not in PORTS:
        raise ClusterError(
            f"--executor {where!r} should be dask://HOST:PORT, dask+tls://HOST:PORT or {SLURM}, "
            f"with a port from {PORTS[0]} to {PORTS[-1]}"
        )
    if SCHEMES[scheme] == "tls":
        _certified(where)
    return f"{SCHEMES[scheme]}://{rest}"


def _certified(where: str) -> None:
    """Look for certificates now: a client that fails for want of them says something else, and late."""
    from distributed.security import Security

    needs = f"{where}: dask+tls needs certificates: distributed.comm.tls in Dask's configuration"
    try:
        found: Any = Security().get_connection_args("client")
    except (OSError, ValueError) as error:  # files that are not there, or hold something else
        raise ClusterError(f"{needs} ({line(error)})") from None
    if found["ssl_context"] is None:
        raise ClusterError(f"{needs} (ca-file, client.cert and client.key)")


def connected(where: str, address: str, security: Security | None = None) -> Client:
    """A client of a scheduler that can take files.

    Raises:
        ClusterError: no scheduler answers, or it has no merlfit.
    """
    from distributed import Client
    from distributed.versions import VersionMismatchWarning

    from .slot import present

    warnings.simplefilter("ignore", VersionMismatchWarning)  # a table; what matters is said in a line of ours
    warnings.filterwarnings("ignore", "Sending large graph")  # a file, where workers do not see it
    try:
        client = Client(address, timeout=CONNECT, set_as_default=False, security=security)
    except (OSError, TimeoutError, ImportError, ValueError, RuntimeError, TypeError) as error:
        why = line(error) if isinstance(error, ImportError | ValueError | TypeError) else ""
        raise ClusterError(
            f"{where}: no scheduler answers there within {CONNECT:g} s{why and f' ({why})'}; start one with "
            "`dask scheduler`, or check host, port, firewall and TLS"
        ) from None
    try:
        client.run_on_scheduler(present, callback_timeout=CONNECT)
    except Exception as error:  # whatever it lacks
        client.close(timeout=CONNECT)
        raise ClusterError(
            f"{where}: the scheduler cannot take files ({type(error).__name__}: {line(error)}); "
            "install there what is here"
        ) from None
    return client


def line(error: BaseException) -> str:
    """The first of what an error says."""
    return (str(error).splitlines() or [""])[0]
