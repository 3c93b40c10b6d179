"""Work on whatever runs Python functions."""

from uuid import uuid4


def engine(client, function):
    """A function that has calls of ``function`` done, of which it gets lists of arguments: by ``client``, or here without one."""

    def done(calls):
        if client is None:
            for arguments in calls:
                function(*arguments)
            return
        # All at once; the engine has its own way with workers that fail.
        futures = []
        try:
            for arguments in calls:
                futures.append(client.submit(_attempt, uuid4().hex, function, *arguments))
            for future in futures:
                future.result()
        except BaseException:
            for future in futures:
                future.cancel()
            raise

    return done


def _attempt(_number, function, *arguments):
    """One call. Engines that remember what they have done do it again for another attempt."""
    function(*arguments)
