#!/bin/sh
cat /root/cast/state
