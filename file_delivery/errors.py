"""The error of file delivery."""


class DeliveryError(Exception):
    """A file cannot be sent or received, or a transfer does not exist.

    Parameters
    ----------
    code : FILE_NOT_FOUND or BUSY
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(f"{code}: {message}")
        self.code = code
