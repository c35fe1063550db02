"""The one error whose message is written for users."""


class ConfigError(ValueError):
    """A request that cannot be met; the message is one sentence a person can act on."""
