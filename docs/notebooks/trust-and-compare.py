# %% [markdown]
# # Trust, and compare
#
# What a verdict rests on, and what happens when a recording is not what it seems: the sensor was knocked in the middle,
# so that its bias stepped.

# %%
import gnomon

recording, truth = gnomon.simulate(gnomon.Scenario(intervals=40), seed=7)
sound = gnomon.calibrate_imu(recording)
print(sound.calibration.assessment.verdict)

# %% [markdown]
# Now the second half gets another bias of the accelerometer: 0.15 m/s^2 along y.

# %%
imu = recording.imus["imu0"]
values = imu.accelerometer.values.copy()
values[len(values) // 2 :, 1] += 0.15
stepped = gnomon.Recording.from_arrays(imu.accelerometer.t_s, imu.gyroscope.values, values)
changed = gnomon.calibrate_imu(stepped)
for finding in changed.calibration.assessment.findings:
    print(finding.severity, finding.code, "-", finding.message)

# %% [markdown]
# Is the calibration good enough for what it is needed for? The same numbers, judged for navigation and for an attitude
# filter.

# %%
for use in ("ahrs", "vio"):
    print(use, gnomon.judge(sound, use).assessment.verdict)

# %% [markdown]
# Are these numbers those of another sensor of the same kind? What each calibration states is held against the other,
# in standard deviations of both. The same sensor before and after the step differs by nothing but the bias.

# %%
other = gnomon.calibrate_imu(gnomon.simulate(gnomon.Scenario(intervals=40), seed=8)[0])
for name, second in (("after the step", changed), ("another sensor", other)):
    comparison = gnomon.compare(sound, second, names=["sound", name])
    print(f"{name}: {comparison.headline}")
    for difference in comparison.differences:
        print(f"    {difference.path}: largest difference {difference.largest:.1f} sigma")
