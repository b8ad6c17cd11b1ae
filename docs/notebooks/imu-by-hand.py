# %% [markdown]
# # An IMU by hand
#
# Forty attitudes by hand calibrate an IMU. Here a simulated sensor takes the place of yours, so that the truth is
# known; with a log of your own, `gnomon.read("log.csv")` is the first line.

# %%
import gnomon

recording, truth = gnomon.simulate(gnomon.Scenario(intervals=40), seed=7)
recording

# %% [markdown]
# Before anything is estimated: is the recording fit for it?

# %%
for finding in gnomon.check(recording):
    print(finding.severity, finding.code, "-", finding.message)

# %% [markdown]
# The calibration, and the numbers that matter, each with its standard deviation.

# %%
result = gnomon.calibrate_imu(recording)
result

# %% [markdown]
# Any figure of the report can be drawn with Matplotlib.

# %%
figure = result.plot("signals")

# %%
figure = result.plot("directions-accelerometer")

# %% [markdown]
# Since this sensor is simulated, the estimate can be held against the truth, in standard deviations.

# %%
comparison = gnomon.compare(result, truth, names=["by hand", "truth"])
print(comparison.headline)

# %% [markdown]
# The numbers go into a file that other programs and the next notebook read, and into the samples.

# %%
gnomon.save(result, "calibration.yaml")
calibrated = result.calibration.imus["imu0"].apply(recording.imus["imu0"])
calibrated
