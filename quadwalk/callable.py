"""A package that can be called: `quadwalk.train` holds modules and is a function of the API."""

from types import ModuleType
from typing import Any


class CallablePackage(ModuleType):
    """The class of a package of the same name as a function of `quadwalk.api`.

    Python puts a package in its parent's namespace when anything in it is imported, in the place of
    the function. So that `quadwalk.train(...)` works before and after, calling it calls that.
    """

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """The function of `quadwalk.api`, which has its arguments."""
        from quadwalk import api

        return getattr(api, self.__name__.rpartition(".")[2])(*args, **kwargs)
