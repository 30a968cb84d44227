"""What Mitsuba logs, in a list instead of on the terminal."""

import contextlib

import mitsuba as mi


class _Appender(mi.Appender):
    def __init__(self):
        super().__init__()
        self.texts = []

    def append(self, level, text):
        self.texts.append(text)

    def log_progress(self, *_):
        pass


@contextlib.contextmanager
def messages():
    """Inside, warnings are collected in the list that this yields."""
    logger, collected = mi.logger(), _Appender()
    before = [logger.appender(i) for i in range(logger.appender_count())]
    mi.set_log_level(mi.LogLevel.Warn)
    logger.clear_appenders()
    logger.add_appender(collected)
    try:
        yield collected.texts
    finally:
        logger.clear_appenders()
        for appender in before:
            logger.add_appender(appender)
        mi.set_log_level(mi.LogLevel.Error)
