"""The ReVNM simulator: worlds, exact ray caster, PyBullet, expert, benchmark.

Kept empty of imports on purpose: training uses worlds, ray caster and expert on machines without PyBullet.
"""
