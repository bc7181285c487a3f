#!/bin/sh
: > /root/cast/start
