"""What the package needs of the machine and of Mitsuba. Imports no other folder."""
