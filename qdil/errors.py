"""The one error that a person is meant to read."""


class ConfigError(ValueError):
    """A request that cannot be met; the message is one sentence a person can act on."""
