"""The services of middlewares on a target. The programs of a middleware without one wait for one another themselves."""

from rtrun.execution.middleware import roscpp
from rtrun.execution.middleware.service import Service

SERVICES: dict[str, Service] = {"roscpp": roscpp.SERVICE}
