"""The services of middlewares on a target. If a middleware has none, its programs wait for one another themselves."""

from rtrun.execution.middleware import roscpp
from rtrun.execution.middleware.service import Service

SERVICES: dict[str, Service] = {"roscpp": roscpp.SERVICE}
